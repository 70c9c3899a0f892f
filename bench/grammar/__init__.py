"""The command line: what commands and keys are, how arguments are read, and help."""
