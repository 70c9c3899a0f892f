"""Searches inside the training part: `tune` of one system, `auto` over all of them."""
