"""Work to do, as values: arguments, cells and plans. Nothing here runs anything."""
