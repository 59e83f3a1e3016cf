"""What a command sees to before its imports."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

# Stops the import of the first library that takes long, whichever comes first.
_INTERRUPTED = """
import os, runpy, signal, sys

class Interrupt:
    def find_spec(self, name, path=None, target=None):
        if name == sys.argv[1]:
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, Interrupt())
sys.orig_argv = [sys.executable, "-m", "xqmap.report"]
runpy.run_module("xqmap.report", run_name="__main__")
"""


def test_ctrl_c_while_importing_is_one_line() -> None:
    for name in ("matplotlib", "hydra", "scipy"):
        done = subprocess.run([sys.executable, "-c", _INTERRUPTED, name], capture_output=True, text=True, timeout=600)
        assert (done.returncode, done.stderr, done.stdout) == (130, "stopped\n", ""), name


_LIBRARY = """
import os, signal, sys
before = signal.getsignal(signal.SIGINT)
import xqmap
assert signal.getsignal(signal.SIGINT) is before
"""


def test_a_program_that_imports_the_package_keeps_its_own_ctrl_c() -> None:
    assert subprocess.run([sys.executable, "-c", _LIBRARY], check=False, timeout=600).returncode == 0


# As in a container that is started for a user its /etc/passwd does not know.
_HOMELESS = """
import os, pwd, sys

def unknown(number):
    raise KeyError(number)

pwd.getpwuid = unknown
import xqmap
from xqmap import doctor
finding = doctor.vulkan()
print(finding.line)
sys.exit(not finding.ok)
"""


def test_a_user_without_a_home_can_render(tmp_path: Path) -> None:
    homeless = {name: value for name, value in os.environ.items() if name != "HOME"}
    command = [sys.executable, "-c", _HOMELESS]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, env=homeless, cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr


def test_a_job_that_shall_survive_its_terminal_does() -> None:
    ask = "from xqmap import launch; print(*map(int, launch.stopping()))"
    for before, stopping in (("", [signal.SIGTERM, signal.SIGHUP]), ("trap '' HUP; ", [signal.SIGTERM])):
        done = subprocess.run(["bash", "-c", f"{before}{sys.executable} -c '{ask}'"], capture_output=True, text=True)
        assert done.stdout.split() == [str(int(number)) for number in stopping], done.stderr
