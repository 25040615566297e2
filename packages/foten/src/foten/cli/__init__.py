"""The command line; each subcommand has its file."""

from foten.cli.command_line import main as main
