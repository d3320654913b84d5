"""Writers of recordings, tables and messages."""
