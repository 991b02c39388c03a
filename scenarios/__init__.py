"""Scenes that run: one module each, to read and to copy."""
