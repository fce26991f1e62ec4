"""Registration of a local point cloud to a georeferenced one: three methods behind one interface (base.py)."""
