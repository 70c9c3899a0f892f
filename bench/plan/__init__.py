"""What is to be done, as values: arguments, cells and plans. Nothing here runs anything."""
