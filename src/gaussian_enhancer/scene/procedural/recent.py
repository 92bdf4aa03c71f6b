"""Cache of recently rendered photos.

A fit asks for each photo several times: to look at it, to fit to it, to write it beside the render.
"""

from collections import OrderedDict
from collections.abc import Callable, Hashable

from torch import Tensor


class Recent:
    """The most recently used tensors, up to a number of bytes; one a process.

    Args:
        capacity: bytes to keep at most; a larger tensor is never kept.
    """

    def __init__(self, capacity: int) -> None:
        self.capacity = capacity
        self.held: OrderedDict[Hashable, Tensor] = OrderedDict()
        self.size = 0

    def get(self, key: Hashable, make: Callable[[], Tensor]) -> Tensor:
        """A copy of the tensor of a key, from the cache or newly made."""
        if key in self.held:
            self.held.move_to_end(key)
            return self.held[key].clone()
        value = make()
        if value.nbytes <= self.capacity:
            self.held[key] = value.clone()
            self.size += value.nbytes
            while self.size > self.capacity:
                self.size -= self.held.popitem(last=False)[1].nbytes
        return value
