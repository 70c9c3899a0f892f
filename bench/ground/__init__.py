"""What every other room stands on: the machine, files, the user's folder, names of parts, typed values."""
