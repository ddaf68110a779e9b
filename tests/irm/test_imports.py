"""What `import irm` brings in."""

import subprocess
import sys


def test_the_package_needs_no_simulator_and_no_plots():
    code = (
        "import sys, irm, irm.maps.cache, irm.checks.verification, irm.checks.classification, irm.queries.full_scan\n"
        "bad = {'mujoco', 'gymnasium', 'torch', 'matplotlib', 'mink'} & set(sys.modules)\n"
        "assert not bad, bad\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_the_contract_names_are_there():
    import irm

    for name in ("ReachabilityMap", "ClassicalInverseReachabilityMap", "InverseReachabilityMap", "FreeSpace", "Status"):
        assert hasattr(irm, name)
