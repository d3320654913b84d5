"""Columns of tables of measurements: numbers, conventions, and columns that nothing reads."""
