"""The command line: commands, their keys, and help."""
