"""Cache of recently rendered photos.

A fit reads each photo several times: to check it, to fit to it, and to write it beside the render.
"""

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable

from torch import Tensor


class TensorCache:
    """LRU cache of tensors with a limit in bytes; one instance per process, which its threads share.

    Args:
        capacity: largest total size in bytes; a larger tensor is not cached.
    """

    def __init__(self, capacity: int) -> None:
        self.capacity = capacity
        self.tensors: OrderedDict[Hashable, Tensor] = OrderedDict()
        self.size = 0
        self._lock = threading.Lock()

    def get(self, key: Hashable, make: Callable[[], Tensor]) -> Tensor:
        """Return a copy of the tensor of a key, from the cache or computed by `make`."""
        with self._lock:
            if key in self.tensors:
                self.tensors.move_to_end(key)
                return self.tensors[key].clone()
        value = make()
        with self._lock:
            if value.nbytes <= self.capacity and key not in self.tensors:  # another thread may have made it, too
                self.tensors[key] = value.clone()
                self.size += value.nbytes
                while self.size > self.capacity:
                    self.size -= self.tensors.popitem(last=False)[1].nbytes
        return value
