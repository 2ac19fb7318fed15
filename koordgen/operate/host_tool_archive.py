"""Archive of the robot-side tool: one .pyz file that a host's Python runs."""

from __future__ import annotations

import io
import zipfile

from koordgen.lang.resources import package

_STUB = "from host_tool.__main__ import main\n\nraise SystemExit(main())\n"
_MADE = (1980, 1, 1, 0, 0, 0)  # time stamp of all entries: the earliest that the ZIP format can represent


def archive() -> bytes:
    """Return the tool as a .pyz. Equal sources give equal bytes on every computer.

    The archive is not compressed, because different versions of zlib may compress to different bytes.
    """
    folder = package() / "operate" / "host_tool"
    texts = {f"host_tool/{path.name}": path.read_bytes() for path in folder.glob("*.py")}
    texts["__main__.py"] = _STUB.encode()
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w", zipfile.ZIP_STORED) as file:
        for name, text in sorted(texts.items()):
            entry = zipfile.ZipInfo(name, _MADE)
            entry.external_attr = 0o644 << 16
            # 3 stands for Unix; it is set on every system, so that the archive has equal bytes everywhere
            entry.create_system = 3
            file.writestr(entry, text)
    return made.getvalue()
