"""Decoders of messages of recordings and streams to scans and poses."""
