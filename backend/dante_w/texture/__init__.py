"""What goes out: UV charts, coverage, baking, filling."""
