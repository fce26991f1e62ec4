"""The rules by theme; `registry.RULES` holds all of them."""
