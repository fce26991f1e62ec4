"""Offline preparation of map packs."""
