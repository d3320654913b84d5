"""Messages that recordings and streams share, to scans and poses."""
