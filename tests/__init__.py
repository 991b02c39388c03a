"""Tests, a package so that benchmarks import `tests.cases` as they do."""
