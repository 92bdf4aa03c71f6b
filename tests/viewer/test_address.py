import socket
import sys

import pytest

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.viewer.address import load_viser, refuse_taken


def test_a_port_in_use_is_refused_and_a_free_one_is_not():
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        listener.listen(1)
        port = listener.getsockname()[1]
        with pytest.raises(InputError, match=rf"port={port}: cannot be listened at .*in use.*; give another port"):
            refuse_taken("127.0.0.1", port)
    refuse_taken("127.0.0.1", port)
    refuse_taken("127.0.0.1", 0)


@pytest.mark.parametrize(
    ("host", "message"), [("192.0.2.1", "is no address of this machine"), ("no host", "host=no host: is no address")]
)
def test_an_address_of_another_machine_is_refused(host, message):
    with pytest.raises(InputError, match=message):
        refuse_taken(host, 0)


def test_without_viser_it_says_how_to_install_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(
        InputError, match=r'view: needs viser.*; install it with pip install "gaussian-enhancer\[viewer\]"'
    ):
        load_viser()
