"""The certificate table of an arm with the structure of Fetch's arm: proved answers without inverse kinematics."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from assets.robots import RobotSpec
from irm.arm.chain import ArmChain
from irm.arm.chain_arrays import chain_arrays
from irm.errors import MapFileError, MapMismatchError, ReachabilityError
from irm.maps.archive import read_archive, write_archive
from irm.maps.certificate.cells import CertificateCells, TableParameters
from irm.maps.certificate.fill_kernel import fill_column
from irm.maps.certificate.lookup_kernel import look_up
from irm.progress import ProgressBar, watched

__all__ = ["CertificateTable", "table_key"]

Floats = NDArray[np.float64]

FORMAT = "certificate table 1"
"""Changed whenever the numbers of a table, or their meaning, change."""


@dataclass(frozen=True)
class CertificateTable:
    """Three arcs of bearings for every cell of poses: certainly, probably, and possibly in reach.

    The first and the last are proved by interval arithmetic over the whole cell. The roll of the TCP does not count.

    Attributes:
        key: digest of arm and parameters; tables with equal keys are equal.
        parameters: the resolution.
        cells: of the poses.
        arcs: (distances, heights, approach axes, 3, 2) uint8 first and last turn of each arc, see
            `irm.maps.certificate.fill_kernel`; read-only.
        chain: the arm.

    Example:
        table = CertificateTable.build(FETCH)
        answers = classify(table, T_base_tcp)
    """

    key: str
    parameters: TableParameters
    cells: CertificateCells
    arcs: NDArray[np.uint8]
    chain: ArmChain

    @staticmethod
    def build(
        robot: RobotSpec | ArmChain | str, *, progress: ProgressBar | None = None, **parameters: Any
    ) -> CertificateTable:
        """The table of a robot.

        Args:
            robot: see `ReachabilityMap.build`; its arm has the structure of Fetch's arm.
            progress: shows how far it is, such as `tqdm.tqdm`.
            **parameters: the fields of `TableParameters`.

        Raises:
            ReachabilityError: the arm has another structure, or the parameters make no sense.
        """
        chain, wanted = ArmChain.of(robot), TableParameters(**parameters)
        cells = CertificateCells.of(chain, wanted)
        axes, arm = cells.approach_axes(), chain_arrays(chain)
        arcs = np.empty((*cells.shape, 3, 2), dtype=np.uint8)
        layers = cells.bottom, cells.thickness, cells.layers
        for column in watched(range(cells.columns), "certificate table", cells.columns, progress):
            fill_column(arm, (column * cells.width, (column + 1) * cells.width), layers, axes, arcs[column])
        arcs.setflags(write=False)
        return CertificateTable(table_key(chain, wanted), wanted, cells, arcs, chain)

    def save(self, path: str | Path) -> None:
        """Write the table to one `.npz` file.

        Raises:
            OSError: the disk is full or cannot be written; an old file of that name stays.
        """
        about = {"format": FORMAT, "robot": self.chain.robot, "key": self.key}
        write_archive(Path(path), about | {"parameters": dataclasses.asdict(self.parameters)}, {"arcs": self.arcs})

    @staticmethod
    def load(path: str | Path, robot: RobotSpec | ArmChain | str) -> CertificateTable:
        """Read a table that `save` wrote.

        Raises:
            FileNotFoundError: no such file.
            MapFileError: the file is damaged or is no table.
            MapMismatchError: it is the table of another robot, or of this robot before it was changed.
        """
        chain = ArmChain.of(robot)
        about, arrays = read_archive(Path(path), ["arcs"])
        if about.get("format") != FORMAT:
            raise MapFileError(f"{path} is no {FORMAT!r} but {about.get('format')!r}; build it again")
        try:
            parameters = TableParameters(**about["parameters"])
        except (KeyError, TypeError, ReachabilityError) as error:
            raise MapFileError(f"{path} has no valid parameters ({error}); build it again") from error
        key = table_key(chain, parameters)
        if about.get("key") != key:
            raise MapMismatchError(f"{path} was built for another arm than that of {chain.robot!r}; build it again")
        cells, arcs = CertificateCells.of(chain, parameters), arrays["arcs"]
        if arcs.dtype != np.uint8 or arcs.shape != (*cells.shape, 3, 2):
            raise MapFileError(f"{path}: the arcs have the wrong type or shape; build it again")
        arcs.setflags(write=False)
        return CertificateTable(key, parameters, cells, arcs, chain)

    def look_up(self, T_base_tcp: Floats) -> tuple[NDArray[np.int8], NDArray[np.bool_]]:
        """Answers (n,) for poses (n, 4, 4) as of `irm.arm.exact.ExactSolver`, and whether each is probably in reach."""
        answers, likely = np.empty(len(T_base_tcp), dtype=np.int8), np.empty(len(T_base_tcp), dtype=bool)
        T = np.ascontiguousarray(T_base_tcp, dtype=float)
        look_up(chain_arrays(self.chain), self.cells.arrays, self.arcs, T, answers, likely)
        return answers, likely


def table_key(chain: ArmChain, parameters: TableParameters) -> str:
    """Digest of everything a table depends on: format, kinematics, parameters."""
    digest = hashlib.sha256(FORMAT.encode())
    for array in (chain.lower, chain.upper, chain.links):
        digest.update(np.ascontiguousarray(array).tobytes())
    digest.update(json.dumps(dataclasses.asdict(parameters), sort_keys=True).encode())
    return digest.hexdigest()[:16]
