"""Processes that are there already, and where they meet."""

from lightning.pytorch.plugins.environments import LightningEnvironment


class Team(LightningEnvironment):
    """Tells Lightning that the processes of this machine were started by the job itself.

    Lightning would start them by repeating the command line, which in a sweep is the whole sweep.

    Args:
        rank: this process.
        port: where they meet.
    """

    def __init__(self, rank: int, port: int) -> None:
        super().__init__()
        self.rank, self.port = rank, port

    @property
    def creates_processes_externally(self) -> bool:
        """They are there."""
        return True

    @property
    def main_address(self) -> str:
        """This machine."""
        return "127.0.0.1"

    @property
    def main_port(self) -> int:
        """Where they meet."""
        return self.port

    def local_rank(self) -> int:
        """This process's number."""
        return self.rank

    def node_rank(self) -> int:
        """The machine's number: there is one."""
        return 0
