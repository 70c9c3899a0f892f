"""The commands, a file each: arguments in, one call, printing out."""
