"""Simulator for the method of regularized Stokeslets; built on `treecode`, still empty."""
