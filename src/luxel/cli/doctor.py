"""`luxel doctor`: is this machine ready, which device computes, and why."""

from __future__ import annotations

from luxel.cli import console, options
from luxel.errors import LuxelError


def list_methods() -> tuple[list[str], list[str]]:
    """Return the methods that are here, installed packages' included, and a sentence on each that cannot be used."""
    from luxel.methods.own import hidden_methods, try_installed
    from luxel.methods.table import METHODS

    faults = [fault for _, fault in try_installed() if fault]
    return list(METHODS), [*faults, *hidden_methods()]


def doctor(device: options.DeviceName = "auto", as_json: options.Json = False, debug: options.Debug = False) -> None:
    """Say which device and why, whether LLVM and OptiX are there, versions, rays a second, and which methods."""
    with console.logs_on_stderr():
        from luxel import runtime

        obstacle = None
        try:
            runtime.start(device)
        except LuxelError as error:
            obstacle = str(error)
        about = runtime.describe()
        if obstacle is not None:
            about |= {"device": None, "variant": None, "reason": obstacle}
        rays: dict[str, float | int] | None = None
        if about["device"] is not None:
            from luxel.bench.rays import ray_benchmark

            rays = ray_benchmark()
        about["rays"] = rays
        about["methods"], notes = list_methods()
    if as_json:
        from luxel.files import to_json

        print(to_json(about))
    else:
        llvm = f"{about['llvm_version']} ({about['llvm_path']})" if about["llvm_path"] else about["llvm"]
        rate = ""
        if rays is not None:
            rate = f"{rays['rays_per_second'] / 1e6:,.1f} million a second into {rays['triangles']:,} triangles"
        versions = {"python": about["python"], **about["versions"]}
        console.print_rows(
            [
                ("device", f"{about['device'] or 'none'}: {about['reason']}"),
                ("variant", about["variant"] or ""),
                ("LLVM", llvm),
                ("OptiX", about["optix"]),
                ("system", f"{about['platform']}, {about['threads']} threads"),
                ("versions", "  ".join(f"{name} {version or 'missing'}" for name, version in versions.items())),
                ("rays", rate),
                ("methods", ", ".join(about["methods"])),
            ]
        )
    console.warn(notes)
    if about["device"] is None:
        raise LuxelError(about["reason"])
