"""Time: states, methods of stepping, step sizes, and conditions when something happens."""
