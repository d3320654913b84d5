"""Situations with flying objects of many sizes and speeds, and with other moving things."""
