"""Items (tables and figures) of the paper on round obstacles in 2D scans."""
