"""``coulombus world``: the display of ``coulombus run --world`` for WebSocket clients."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import click

from coulombus.cli.errors import EXIT_STATUS, errors
from coulombus.cli.options import BUS_VARIABLE, option, with_options
from coulombus.cli.page_options import LOOPBACK, tornado_needed
from coulombus.cli.tables import echo
from coulombus.system.exit import printed

__all__ = ["world"]

PORT = 8643


@click.command("world", epilog=EXIT_STATUS)
@with_options
def world(
    bus_text: Annotated[
        str, option("--bus", "The host's bus.", envvar=BUS_VARIABLE, metavar="B", default="coulombus:bench")
    ],
    page: Annotated[
        Path | None,
        option("Page to serve: one HTML file.", type=click.Path(path_type=Path, exists=True, dir_okay=False)),
    ],
    web_port: Annotated[int, option("0: a free port.", type=click.IntRange(0, 65535), metavar="N", default=PORT)],
    web_host: Annotated[str, option("Address of this machine to serve at.", metavar="H", default=LOOPBACK)],
    seconds: Annotated[float | None, option("End after this many seconds.", type=click.FloatRange(0, min_open=True))],
    as_json: Annotated[bool, option("--json", "One JSON object: ready, with the URL.")],
) -> None:
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
        token_file = f"{address.kind}-{address.name}".replace("/", "_") + ".world-token"
        token = kept_token(socket_path(address.kind).parent / token_file)

        def ready(url: str) -> None:
            socket_url = url.replace("http:", "ws:", 1) + "world"
            with printed():
                if as_json:
                    echo(json.dumps({"event": "ready", "url": url, "websocket": socket_url}))
                else:
                    echo(f"world: {socket_url}" + (f"\npage: {url}" if page is not None else ""))

        gateway = Gateway(world_path(address), Relay, token, page=page)
        serve_gateway(gateway, ready, host=web_host, port=web_port, seconds=seconds)
