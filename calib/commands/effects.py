"""`calib effects`: the catalogue."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from calib.terminal import console, options

if TYPE_CHECKING:
    from sim.effects import Effect


def _names(incomplete: str) -> list[str]:
    from sim.effects import EFFECTS

    return [e.name for e in EFFECTS if e.name.startswith(incomplete)]


def command(
    name: Annotated[str | None, typer.Argument(metavar="EFFECT", help="One effect in full.", autocompletion=_names)] = None,
    as_json: options.Json = False,
) -> None:
    """List the physical effects that a diagnosis can name: what they are, how they look, their parameters.

    Example:

        calib effects stribeck_friction
    """
    from sim.effects import BROKEN, EFFECTS, effect_named, effect_origin

    chosen = EFFECTS if name is None else (effect_named(name),)
    if as_json:
        console.print_json({"schema": "effects/1", "effects": [_plain(e) for e in chosen]})
    elif name is None:
        rows = [[e.name, e.scope, ", ".join(f"{p.name} [{_unit(p.unit)}]" for p in e.parameters), e.summary] for e in EFFECTS]
        origins = [effect_origin(e.name) for e in EFFECTS]
        if len(set(origins)) > 1:
            rows = [[*row, where] for row, where in zip(rows, origins, strict=True)]
        console.table(["effect", "of", "parameters", "what it is", *(["from"] if len(set(origins)) > 1 else [])], rows)
        for sentence in BROKEN.values():
            console.warn(sentence)
    else:
        _describe(chosen[0])


def _describe(effect: Effect) -> None:
    from sim.effects import effect_origin

    console.say(f"{effect.name}: {effect.summary}")
    rows = [["law", f"{effect.law}."]]
    rows += [["other law", f"{law}."] for law in dict.fromkeys(other.law for other in effect.forms())]
    rows.append(["looks like", effect.looks])
    rows += [["distinguished by", effect.experiment]] if effect.experiment else []
    rows += [["reference", effect.reference], ["comes from", effect_origin(effect.name)]]
    rows.append(["belongs to", "one joint" if effect.scope == "joint" else "the whole arm"])
    console.table(["", ""], rows)
    console.table(
        ["parameter", "unit", "least", "greatest", "meaning"],
        [[p.name, _unit(p.unit), p.lower, p.upper, p.meaning] for p in effect.parameters],
    )


def _plain(effect: Effect) -> dict[str, object]:
    from sim.effects import effect_origin

    return {
        "name": effect.name,
        "from": effect_origin(effect.name),
        "scope": effect.scope,
        "summary": effect.summary,
        "law": effect.law,
        "other_laws": list(dict.fromkeys(other.law for other in effect.forms())),
        "looks": effect.looks,
        "experiment": effect.experiment or None,
        "reference": effect.reference,
        "parameters": [
            {"name": p.name, "unit": p.unit, "meaning": p.meaning, "lower": p.lower, "upper": p.upper}
            for p in effect.parameters
        ],
    }


def _unit(unit: str) -> str:
    from calib.terminal.quantity import printed_unit

    return printed_unit(unit) or "1"
