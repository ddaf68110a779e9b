"""What `import irm` brings in."""

import subprocess
import sys


def test_the_package_needs_no_simulator_and_no_plots():
    code = (
        "import sys, irm\n"
        "bad = {'mujoco', 'gymnasium', 'torch', 'matplotlib', 'mink'} & set(sys.modules)\n"
        "assert not bad, bad\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
