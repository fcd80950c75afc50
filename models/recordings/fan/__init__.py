"""Fans: found in pictures, and made of pings."""
