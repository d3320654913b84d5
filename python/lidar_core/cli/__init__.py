"""The `lidar-core` command: one file per subcommand; heavy imports stay inside the functions."""

import sys
from importlib import import_module

import typer

from lidar_core.errors import LidarCoreError

app = typer.Typer(
    name="lidar-core",
    help="From raw LiDAR to the list of things around a robot that matter.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=True,
)

for _name in ("demo", "info", "simulate", "detect"):
    app.command(_name)(import_module(f"lidar_core.cli.{_name}").command)


def main() -> None:
    """Run the command; expected errors end in one readable line and exit status 2."""
    try:
        app()
    except (LidarCoreError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
