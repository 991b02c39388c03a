"""Ways to evaluate the sum, each a module with ``prepare`` (once) and ``update`` (a strength)."""
