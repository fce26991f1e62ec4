"""Imports every module of the installed wheel, and checks the networks that it brings.

Modules of an optional extra may only miss that extra's packages.
"""

import importlib
import pathlib
import pkgutil
import sys

import visloc_companion

OPTIONAL = {"torch", "onnx", "onnxscript", "onnxruntime", "open3d", "laspy", "starlette", "uvicorn", "prometheus_client"}

where = pathlib.Path(visloc_companion.__file__).parent
if "site-packages" not in where.parts:
    sys.exit(f"not the installed wheel: {where}")
names = [module.name for module in pkgutil.walk_packages([str(where)], "visloc_companion.")]
if len(names) < 50:
    sys.exit(f"the wheel holds only {len(names)} modules")
for name in names:
    try:
        importlib.import_module(name)
    except ModuleNotFoundError as why:
        if why.name is None or why.name.split(".")[0] not in OPTIONAL:
            raise
print(f"imported {len(names)} modules of {where.name}")

from visloc_companion.localise.model_folder import read_golden, read_manifest, read_variant, shipped_model  # noqa: E402


def files_of(room: pathlib.Path) -> dict[str, bytes]:
    """The page's files by name."""
    return {file.name: file.read_bytes() for file in (room / "web" / "page").iterdir()}


page = files_of(pathlib.Path(__file__).resolve().parents[1] / "visloc_companion")
if files_of(where) != page:
    sys.exit("the wheel does not hold the dashboard's page as the checkout does")
print(f"the dashboard's page: {len(page)} files, {sum(map(len, page.values()))} bytes")

checkout = pathlib.Path(__file__).resolve().parents[1] / "models"
for folder in sorted(path.parent for path in checkout.glob("*/manifest.json")):
    installed = where / "models" / folder.name
    manifest = read_manifest(installed)
    read_golden(installed, manifest)
    sizes = {variant: len(read_variant(installed, manifest, variant)) for variant in manifest.variants}
    print(f"network {manifest.identity}: {sizes} bytes")
if (checkout / "default").exists():
    print(f"shipped is {read_manifest(shipped_model()).identity}")
