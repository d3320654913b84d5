"""Items of the paper on round obstacles in 2D scans."""
