#!/usr/bin/python3
"""Packs the add-on, with the Python client inside, for Blender's Preferences >
Add-ons > Install:

    make_zip.py FILE.zip

The same sources give the same bytes.
"""
import os
import sys
import zipfile

HERE = os.path.dirname(os.path.abspath(__file__))
ADDON = os.path.join(HERE, "blobfield_addon")
CLIENT = os.path.join(HERE, os.pardir, "python", "blobfield")
LICENSE = os.path.join(HERE, os.pardir, os.pardir, "LICENSE")


def sources():
    """(path, name in the archive) of all files."""
    for folder, name in ((ADDON, "blobfield_addon"),
                         (CLIENT, "blobfield_addon/blobfield")):
        for file in sorted(os.listdir(folder)):
            if file.endswith((".py", ".typed")):
                yield os.path.join(folder, file), f"{name}/{file}"
    yield LICENSE, "blobfield_addon/LICENSE"


def main():
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    with zipfile.ZipFile(sys.argv[1], "w", zipfile.ZIP_DEFLATED) as archive:
        for path, name in sources():
            entry = zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))
            entry.external_attr = 0o644 << 16
            entry.compress_type = zipfile.ZIP_DEFLATED
            with open(path, "rb") as file:
                archive.writestr(entry, file.read())


if __name__ == "__main__":
    main()
