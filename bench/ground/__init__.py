"""What all rooms use: registry of parts, typed values, files and folders, the machine, timing."""
