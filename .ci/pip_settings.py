"""Prints for a shell, in uv's words, what pip was told of indexes, wheels, proxies and certificates."""

from __future__ import annotations

import ast
import os
import shlex
import subprocess
import sys

# pip's option: uv's variables, and what stands between several values there.
NAMES = {
    "index-url": (("UV_DEFAULT_INDEX",), " "),
    "extra-index-url": (("UV_INDEX",), " "),
    "no-index": (("UV_NO_INDEX",), " "),
    "find-links": (("UV_FIND_LINKS",), ","),
    "trusted-host": (("UV_INSECURE_HOST",), " "),
    "proxy": (("HTTP_PROXY", "HTTPS_PROXY"), " "),
    "cert": (("SSL_CERT_FILE",), " "),
    "client-cert": (("SSL_CLIENT_CERT",), " "),
    "timeout": (("UV_HTTP_TIMEOUT",), " "),
}


def translated(listing: str) -> dict[str, str]:
    """``pip config list`` as variables for uv: its variables outdo its files, there 'install' outdoes 'global'."""
    told = {}
    for place in ("global.", "install.", ":env:."):
        for line in listing.splitlines():
            name, _, value = line.partition("=")
            if name.startswith(place):
                told[name.removeprefix(place).removeprefix("default-")] = str(ast.literal_eval(value))
    found = {}
    for name, (variables, between) in NAMES.items():
        if name in told:
            found.update(dict.fromkeys(variables, between.join(told[name].split())))
    if "UV_INDEX" in found:
        # pip takes the best version of all indexes, uv by default that of the first which knows the name.
        found["UV_INDEX_STRATEGY"] = "unsafe-best-match"
    return found


if __name__ == "__main__":
    listing = subprocess.run([sys.executable, "-m", "pip", "config", "list"], capture_output=True, text=True).stdout
    for variable, value in translated(listing).items():
        if variable not in os.environ:
            print(f"export {variable}={shlex.quote(value)}")
