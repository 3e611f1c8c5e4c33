"""The `capture` command: one module per subcommand, with heavy imports inside its `run`."""

from capture.cli.main import main

__all__ = ["main"]
