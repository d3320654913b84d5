"""Tables of tracks, circles and shapes: CSV, Parquet, TUM; and tables read back."""
