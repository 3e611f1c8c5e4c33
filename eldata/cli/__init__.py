"""The `eldata` command: one module a subcommand, heavy imports inside of its `run`."""
