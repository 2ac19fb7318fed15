"""The robot-side tool as one file that any Python of a host runs."""

from __future__ import annotations

import io
import zipfile

from koordgen.lang.resources import package

_STUB = "from host_tool.__main__ import main\n\nraise SystemExit(main())\n"
_MADE = (1980, 1, 1, 0, 0, 0)  # the earliest time that a ZIP file can tell


def archive() -> bytes:
    """Return the tool as a .pyz. The same sources give the same bytes on every computer, so nothing is compressed."""
    folder = package() / "operate" / "host_tool"
    texts = {f"host_tool/{path.name}": path.read_bytes() for path in folder.glob("*.py")}
    texts["__main__.py"] = _STUB.encode()
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w", zipfile.ZIP_STORED) as file:
        for name, text in sorted(texts.items()):
            entry = zipfile.ZipInfo(name, _MADE)
            entry.external_attr = 0o644 << 16
            entry.create_system = 3  # Unix, on whatever system it is made
            file.writestr(entry, text)
    return made.getvalue()
