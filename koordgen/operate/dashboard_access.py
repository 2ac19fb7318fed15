"""Access to the dashboard: address to bind to, TLS certificate, and token that a browser must send.

At the loopback address only programs on this computer can reach the dashboard. At any other address everybody on the
network can, so TLS and a token are required there.
"""

from __future__ import annotations

import ipaddress
import os
import secrets
import ssl
from pathlib import Path

from koordgen.lang.node import Node

LOOPBACK = "127.0.0.1"
SHORTEST_TOKEN = 32  # smallest length of a token, in characters


class AccessRefused(Exception):
    """Raised if the dashboard cannot start; `help` says what to do.

    `usage`: True if a wrong option is the reason, False if a file is the reason.
    """

    def __init__(self, message: str, help: str, usage: bool = False) -> None:
        super().__init__(message)
        self.help = help
        self.usage = usage


class Access(Node):
    """Access settings: address to bind to, TLS context (None: plain HTTP), token (empty: not required)."""

    host: str
    tls: ssl.SSLContext | None
    token: str


def access(bind: str, port: int, cert: str | None, key: str | None, token: str | None) -> Access:
    """Check the options of the command, and read the files that they name. Raises Refused.

    A token file that does not exist is made, with a new random token.
    """
    tunnel = f"or leave out --bind and open an SSH tunnel from the other computer: ssh -L {port}:{LOOPBACK}:{port} "
    tunnel += "USER@THIS_COMPUTER"
    if bool(cert) != bool(key):
        raise AccessRefused("--tls-cert and --tls-key belong together", "give both options or neither", usage=True)
    if not _is_loopback(bind) and not (cert and key and token):
        missing = [name for name, value in (("--tls-cert", cert), ("--tls-key", key), ("--token", token)) if not value]
        message = f"--bind {bind}: everybody on that network could open the dashboard; {', '.join(missing)} missing"
        raise AccessRefused(message, f"give {', '.join(missing)}, {tunnel}", usage=True)
    context = _context(cert, key) if cert and key else None
    return Access(bind, context, read_token(Path(token)) if token else "")


def _is_loopback(bind: str) -> bool:
    try:
        return ipaddress.ip_address(bind).is_loopback
    except ValueError:
        return bind == "localhost"


def _context(cert: str, key: str) -> ssl.SSLContext:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    help = "a PEM certificate and its unencrypted PEM key are expected"
    try:
        context.load_cert_chain(cert, key, password=lambda: "")
    except OSError as error:  # includes ssl.SSLError, a subclass of OSError
        raise AccessRefused(f"{cert}, {key}: {error.strerror or error}", help) from None
    return context


def read_token(path: Path) -> str:
    """Return the token in a file that only its owner may read.

    If the file does not exist, make it with a new token.

    Raises Refused.
    """
    try:
        with path.open(encoding="ascii", errors="replace") as file:
            mode = os.fstat(file.fileno()).st_mode & 0o777
            token = file.read(4096).strip()
    except FileNotFoundError:
        return _new_token(path)
    except OSError as error:
        raise AccessRefused(f"{path}: {error.strerror}", "choose another token file: `--token FILE`") from None
    if mode & 0o077:
        raise AccessRefused(f"{path} has mode {mode:04o}: other users can read it", f"chmod 600 {path}")
    if len(token) < SHORTEST_TOKEN or not token.isascii() or not token.isprintable() or " " in token:
        help = f"delete {path}; the command then makes a new token"
        raise AccessRefused(f"{path} holds no token of at least {SHORTEST_TOKEN} printable characters", help)
    return token


def _new_token(path: Path) -> str:
    token = secrets.token_urlsafe(32)
    try:
        with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="ascii") as file:
            file.write(token + "\n")
    except OSError as error:
        raise AccessRefused(f"{path}: {error.strerror}", "choose another token file: `--token FILE`") from None
    return token
