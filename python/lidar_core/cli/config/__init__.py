"""`lidar-core config`: commands on configuration files."""

import typer

from lidar_core.cli.config import files, fit
from lidar_core.cli.shared.common import help_text, stoppable

app = typer.Typer(
    help="Show, start, migrate, fit and describe configuration files (TOML).", no_args_is_help=True
)
app.command()(files.show)
app.command()(files.init)
app.command()(files.migrate)
app.command("fit", help=help_text(fit.command))(stoppable(fit.command))
app.command()(files.schema)
