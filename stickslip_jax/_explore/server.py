"""The explorer as a page that this machine serves to its own browser, and to nobody else.

It listens on the loopback address. All addresses begin with a secret, so that only who was told it gets a page, and
data comes only from pages of the same origin (Bokeh checks it): another page in the same browser, which can guess the
port, has neither. What pages send are values of controls; none is run.
"""

import secrets
import socket
import webbrowser
from collections.abc import Callable
from typing import Any

import panel as pn

from .page import Explorer
from .scene import Scene

ADDRESS = "127.0.0.1"


def serve(scene: Scene, *, port: int, opens: bool, say: Callable[[str], None]) -> None:
    """Serve the explorer until Ctrl-C. `port` 0: any free one. Raises OSError for one that is taken."""
    port = _free(port)
    secret = secrets.token_urlsafe(24)
    address = f"http://{ADDRESS}:{port}/{secret}/"
    server: Any = pn.serve(
        {"": lambda: Explorer(scene)}, address=ADDRESS, port=port, prefix=secret, show=False, start=False,
        websocket_origin=[f"{ADDRESS}:{port}"], title="stickslip explorer", verbose=False, threaded=False,
    )  # fmt: skip
    say(f"The explorer is at {address}\nCtrl-C ends it.")
    if opens:
        webbrowser.open(address)
    try:
        server.start()
        server.io_loop.start()
    finally:
        server.stop()


def _free(port: int) -> int:
    """The port, or any free one for 0. Raises OSError if it is taken."""
    with socket.socket() as tried:
        tried.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            tried.bind((ADDRESS, port))
        except OSError as error:
            raise OSError(
                f"Port {port} cannot be used ({error.strerror}); choose another, or 0 for any free one."
            ) from None
        return tried.getsockname()[1]
