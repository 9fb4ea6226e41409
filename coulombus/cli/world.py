"""``coulombus world``: the display of ``coulombus run --world`` for WebSocket clients."""

from __future__ import annotations

import json
from pathlib import Path

import click

from coulombus.cli.common import BUS_VARIABLE, printed
from coulombus.cli.errors import EXIT_STATUS, errors
from coulombus.cli.page_options import LOOPBACK, tornado_needed
from coulombus.cli.tables import echo

__all__ = ["world"]

PORT = 8643


@click.command("world", epilog=EXIT_STATUS)
@click.option(
    "--bus",
    "bus_text",
    envvar=BUS_VARIABLE,
    metavar="B",
    default="coulombus:bench",
    show_default=True,
    help="The host's bus.",
)
@click.option(
    "--page", type=click.Path(path_type=Path, exists=True, dir_okay=False), help="Page to serve: one HTML file."
)
@click.option(
    "--web-port", type=click.IntRange(0, 65535), metavar="N", default=PORT, show_default=True, help="0: a free port."
)
@click.option(
    "--web-host", metavar="H", default=LOOPBACK, show_default=True, help="Address of this machine to serve at."
)
@click.option("--seconds", type=click.FloatRange(0, min_open=True), default=None, help="End after this many seconds.")
@click.option("--json", "as_json", is_flag=True, help="One JSON object: ready, with the URL.")
def world(bus_text: str, page: Path | None, web_port: int, web_host: str, seconds: float | None, as_json: bool) -> None:
    """Let WebSocket clients use the display of `coulombus run --world`: browsers, game engines.

    Prints the address, which has the token. A client connects to ws://.../TOKEN/world.

    \b
    Examples:
      coulombus world
      coulombus world --page examples/worlds/wall.html
    """
    with errors():
        from coulombus.host.world.hand import world_path
        from coulombus.host.world.relay import Relay
        from coulombus.wire.address import parse_address, socket_path

        with tornado_needed():
            from coulombus.monitor.web.access import kept_token
            from coulombus.monitor.web.world_gateway import Gateway, serve_gateway

        address = parse_address(bus_text)
        kept = f"{address.kind}-{address.name}".replace("/", "_") + ".world-token"
        token = kept_token(socket_path(address.kind).parent / kept)

        def ready(url: str) -> None:
            socket_url = url.replace("http:", "ws:", 1) + "world"
            with printed():
                if as_json:
                    echo(json.dumps({"event": "ready", "url": url, "websocket": socket_url}))
                else:
                    echo(f"world: {socket_url}" + (f"\npage: {url}" if page is not None else ""))

        gateway = Gateway(world_path(address), Relay, token, page=page)
        serve_gateway(gateway, ready, host=web_host, port=web_port, seconds=seconds)
