"""Blender's Python as a child process: orders out, answers in, one JSON line each (see `bake_in_blender.py`)."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import numpy as np

from luxel.errors import LuxelError

SCRIPT = Path(__file__).with_name("bake_in_blender.py")
SEED = 1
COLOR_SAMPLES = 64
"""Of the albedo that denoised bakes are divided by."""


class Blender:
    """A Python that has `bpy`, holding one scene from a folder. A context manager: the process ends with it."""

    def __init__(self, python: str, folder: Path, threads: int) -> None:
        self.folder = folder
        self.log = (folder / "blender.log").open("w")
        command = [python, str(SCRIPT), str(folder)]
        try:
            self.child = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self.log, text=True
            )
        except OSError as error:
            self.log.close()
            raise LuxelError(f"cannot start {python}: {error.strerror}; name a Python that has bpy") from error
        try:
            self.about = self.ask(do="load", threads=threads)
        except LuxelError:
            self.__exit__()
            raise
        self.color: np.ndarray | None = None

    def ask(self, **order: Any) -> dict[str, Any]:
        """Return the answer to an order. Raises LuxelError where Blender refuses, or is no more."""
        assert self.child.stdin is not None and self.child.stdout is not None
        try:
            self.child.stdin.write(json.dumps(order) + "\n")
            self.child.stdin.flush()
        except BrokenPipeError:
            pass
        line = self.child.stdout.readline()
        if not line:
            last = ((self.folder / "blender.log").read_text().strip().splitlines() or ["it said nothing"])[-1]
            raise LuxelError(f"Blender's Python ended at '{order['do']}': {last}")
        answer = json.loads(line)
        if "error" in answer:
            raise LuxelError(f"Blender refused '{order['do']}': {answer['error']}")
        return answer

    def light(self, order: dict[str, Any]) -> float:
        """Set the lights; return the seconds that it took."""
        return self.ask(**order)["light_s"]

    def bake(self, samples: int, passes: list[str], seed: int = SEED) -> tuple[np.ndarray, float]:
        """Return irradiance / pi (H, W, 4; alpha: baked) and the seconds until it was there."""
        return self._bake("DIFFUSE", samples, passes, False, seed)

    def bake_denoised(self, samples: int, denoise: bool = True) -> tuple[np.ndarray, float]:
        """Return the same from Blender's combined bake, which alone it denoises, divided by baked albedo.

        The seconds are those of the combined bake.
        """
        if self.color is None:
            self.color, _ = self._bake("DIFFUSE", COLOR_SAMPLES, ["COLOR"], False, SEED)
        sheet, seconds = self._bake("COMBINED", samples, ["DIRECT", "INDIRECT", "DIFFUSE"], denoise, SEED)
        sheet[..., :3] /= np.maximum(self.color[..., :3], 1e-6)
        return sheet, seconds

    def _bake(self, kind: str, samples: int, passes: list[str], denoise: bool, seed: int) -> tuple[np.ndarray, float]:
        answer = self.ask(
            do="bake", kind=kind, samples=samples, seed=seed, passes=passes, denoise=denoise, out="texels.npy"
        )
        return np.load(self.folder / "texels.npy"), answer["bake_s"] + answer["read_s"]

    def __enter__(self) -> Blender:
        return self

    def __exit__(self, *_: object) -> None:
        assert self.child.stdin is not None and self.child.stdout is not None
        # The end of its orders is the end of its work.
        self.child.stdin.close()
        try:
            self.child.wait(timeout=20)
        except subprocess.TimeoutExpired:
            self.child.kill()
            self.child.wait()
        self.child.stdout.close()
        self.log.close()
