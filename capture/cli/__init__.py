"""The `capture` command: one module a subcommand, heavy imports inside of its `run`."""

from capture.cli.main import main

__all__ = ["main"]
