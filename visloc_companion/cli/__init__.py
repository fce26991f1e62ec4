"""The visloc command."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
"""Set before numpy is imported: its matrices are small here, and what several threads of it cost each other beside another busy
process is more than they bring."""
