"""The version of both packages; pyproject.toml and CITATION.cff are read or tested against it."""

__version__ = "0.1.0"
