"""Spectra that Mitsuba's RGB variants cannot evaluate, written as tables that they turn into colours."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np

WAVELENGTHS = np.linspace(360.0, 830.0, 95)
"""Nanometres at which a black body is tabulated."""
PLANCK, SPEED, BOLTZMANN = 6.62607015e-34, 2.99792458e8, 1.380649e-23


def tabulate_spectra(state: Any, config: Any) -> None:
    """Replace spectra of type blackbody, regular and irregular by lists of values, in the parser's `state`.

    Raises `ValueError` for one that is incomplete.
    """
    makers = {"blackbody": _black_body, "regular": _regular, "irregular": _irregular}
    tables: dict[int, Any] = {}
    for index, node in enumerate(state.nodes):
        maker = makers.get(node.props.plugin_name())
        if maker is None:
            continue
        try:
            wavelengths, values = maker(node.props)
        except (KeyError, RuntimeError, ValueError) as error:
            kind, place = node.props.plugin_name(), mi.parser.file_location(state, node)
            raise ValueError(f"a spectrum of type '{kind}' is incomplete ({error}) at {place}") from error
        tables[index] = _as_property(wavelengths, values, config)
    for node in state.nodes if tables else ():
        for key in list(node.props.keys()):
            value = node.props[key]
            if isinstance(value, mi.Properties.ResolvedReference) and value.index() in tables:
                del node.props[key]
                node.props[key] = tables[value.index()]


def _as_property(wavelengths: np.ndarray, values: np.ndarray, config: Any) -> Any:
    """Return what the parser makes of a list of values; it turns into a colour as what uses it demands."""
    pairs = ", ".join(f"{at:.9g}:{value:.9g}" for at, value in zip(wavelengths, values, strict=True))
    text = f'<scene version="3.0.0"><bsdf type="diffuse"><spectrum name="table" value="{pairs}"/></bsdf></scene>'
    small = mi.parser.parse_string(config, text)
    return small.nodes[1].props["table"]


def _black_body(props: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return Planck's law in W/(m^2 sr nm), Mitsuba's unit."""
    low, high = float(props.get("wavelength_min", 360.0)), float(props.get("wavelength_max", 830.0))
    at = WAVELENGTHS[(low <= WAVELENGTHS) & (high >= WAVELENGTHS)]
    metres = at * 1e-9
    exponent = PLANCK * SPEED / (metres * BOLTZMANN * float(props["temperature"]))
    return at, 2.0 * PLANCK * SPEED**2 / (metres**5 * np.expm1(exponent)) * 1e-9


def _regular(props: Any) -> tuple[np.ndarray, np.ndarray]:
    values = _numbers(props["values"])
    return np.linspace(float(props["wavelength_min"]), float(props["wavelength_max"]), len(values)), values


def _irregular(props: Any) -> tuple[np.ndarray, np.ndarray]:
    return _numbers(props["wavelengths"]), _numbers(props["values"])


def _numbers(text: Any) -> np.ndarray:
    return np.array([float(word) for word in str(text).replace(",", " ").split()])
