"""What a diagnosis claims, in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from calib.terminal.quantity import printed_unit as unit
from calib.terminal.quantity import rounded, significant

Numbers = Mapping[str, Any]
CONTACT = "external_contact"
SHORT = 60  # longest formula in a sentence, in characters; longer ones are on the page and in diagnosis.json only
# Residual RMS of sliding joints over the noise above which model and recordings disagree. It is at most 1.16 on 20 simulated recordings
# without an identifiable effect (twelve sessions of the mock's arms, eight cases of the exam of seed 26112831, four of them clean), and 3.7
# where the viscous friction of the held-out recording is 1.7 times that of the others.
DISAGREES = 1.5
LEAST_CHANCE = 0.001  # the far tail of a distribution that is itself estimated supports no smaller probability
PEOPLE = ("coulomb", "stribeck")  # people whose names occur in effect names
VARIABLES = {
    "q": "position", "dq": "speed", "ddq": "acceleration", "load": "load", "time": "time", "memory": "the recent motion",
    "hysteresis": "the travel since a reversal", "resonance": "a resonance driven by the acceleration",
    "tone": "a constant oscillation", "spot": "friction at one angle",
}  # fmt: skip


def bad_data(n: Numbers) -> str:
    return f"The data cannot be used: {'; '.join(n['failed']) or 'see the checks in the report'}"


def complete(n: Numbers) -> str:
    if n["ratio"] is None:
        return (
            f"No effect that these recordings can show is missing from the model of {n['arm']}; how far the residual is above the "
            "noise was not measured, so a small effect may be missed"
        )
    where = f"after a parameter refit the largest residual RMS of a sliding joint is {n['ratio']:.1f} times the noise, at {n['joint']}"
    if above_noise(n):
        return f"No effect is identified, but the model of {n['arm']} does not agree with {n['log']}: {where}"
    return f"No effect is missing from the model of {n['arm']}: {where}"


def above_noise(n: Numbers) -> bool:
    """Whether the residual after a refit is too large for agreement; False if no noise was measured."""
    return (n["ratio"] or 0.0) > DISAGREES


def none_accepted(n: Numbers) -> str:
    return f"No effect is identified: the model of {n['arm']} does not agree with the log, but every effect that was tried is refused"


def unchanged(n: Numbers) -> str:
    return f"Nothing has changed on {n['arm']} since the {n['healthy']} healthy recordings, beyond their own variation"


def missing(n: Numbers) -> str:
    if all(e["effect"] == CONTACT for e in n["effects"]):
        return _touched(n["effects"])
    several = f"{len(n['effects'])} effects: " if len(n["effects"]) > 1 else ""
    return f"The model is missing {several}{_found(n['effects'])}"


def changed(n: Numbers) -> str:
    if all(e["effect"] == CONTACT for e in n["effects"]):
        return _touched(n["effects"])
    return f"Changed since the healthy recordings: {_found(n['effects'])}"


def unexplained(n: Numbers) -> str:
    known = f"{missing(n)}. In addition, a" if n["effects"] else "A"
    text = f"{known} residual remains that no effect in the catalogue explains"
    if not n["joints"]:
        return text
    largest, *others = sorted(n["joints"], key=lambda u: -u["rms"])
    first = f"{largest['joint']} (RMS {_size(largest)}{_depending(largest['depends_on'])})"
    smaller = [f"{u['joint']} ({_size(u)})" for u in others]
    return f"{text}: {listed([first, *smaller])}"


def law(n: Numbers) -> str:
    removed = 1 - n["rms_with"] / n["rms_without"]
    formula = f" {n['formula']}" if len(n["formula"]) <= SHORT else ""
    return (
        f"A friction law{formula}, fitted where no catalogue effect fits, removes {removed:.0%} of the residual RMS at {n['joint']} "
        "on recordings left out of its fit"
    )


def driving(n: Numbers) -> str:
    worst = min(n["joints"], key=lambda x: x["torque"])
    where = f"{significant(worst['torque'], 2)} N m at {significant(worst['speed'], 2)} rad/s at {worst['joint']}"
    return (
        f"friction drives {listed([x['joint'] for x in n['joints']])} ({where}), which is impossible for a passive joint: the recorded torque excludes "
        "what the controller adds, such as its friction compensation, or has the wrong sign. Record the torque or current of the motors, and "
        "do not simulate this arm"
    )


def possible(n: Numbers) -> str:
    how = f". To decide: {n['experiment'].rstrip('.')}" if n["experiment"] else ""
    draws = f"{n['simulated']} simulated recordings" if n["simulated"] else "the simulated recordings"
    return (
        f"Possibly {words(n['effect'], n['joint'])}, which does not pass every test for a name. Of {draws} with noise alone, at most "
        f"{chance(n['chance'])} show any of the effects tried as strongly; they leave out errors in the form of the model{how}"
    )


def chance(share: float) -> str:
    """A false-name rate in percent."""
    return f"{100 * max(share, LEAST_CHANCE):.2g}%"


def refused(n: Numbers) -> str:
    return f"{n['text'][0].upper()}{n['text'][1:]}"


def refit(n: Numbers) -> str:
    moves = []
    for m in n["parameters"][:4]:
        by = m["to"] - m["from"]
        far = f"to {significant(m['to'])} times its value" if m["unit"] == "times" else f"{by:+.3g} {unit(m['unit'])}"
        where = f" at {m['joint']}" if m["joint"] else ""
        moves.append(f"{m['name']}{where} {far} ({abs(by) / m['prior_std']:.0f} times its tolerance)")
    return f"A parameter refit without any effect moves {listed(moves)}"


def ripple(n: Numbers) -> str:
    first, more = n["parameters"][:3], len(n["parameters"]) - 3
    found = [f"{significant(m['to'])} {unit(m['unit'])} at {m['joint']} ({m['name'].partition(' of ')[2]})" for m in first]
    if more > 0:
        found.append(f"at {more} more joint{'s' if more > 1 else ''}")
    return f"Gear ripple is fitted alongside every effect: {listed(found)}"


def alike(n: Numbers) -> str:
    others = listed([words(o["effect"], o.get("joint")) for o in n["others"]])
    return f"From this data {words(n['effect'], n.get('joint'))} cannot be distinguished from {others}"


def removed(n: Numbers) -> str:
    return (
        f"On {n['log']} the corrected arm has a residual RMS of {significant(n['after'], 3)} {unit(n['unit'])} at {n['joint']}, the nominal arm "
        f"{significant(n['before'], 3)}"
    )


def motion(n: Numbers) -> str:
    how = f"Simulated for {n['horizon_s']:g} s under the measured torque ({n['loop']} loop)"
    arms = {"corrected": n["after"], "nominal": n["before"]}
    stable = [f"off by {significant(1e3 * x)} mm RMS with the {arm} arm" for arm, x in arms.items() if x is not None]
    unstable = [f"the {arm} arm" for arm, x in arms.items() if x is None]
    if unstable:
        stable.append(f"the simulation of {listed(unstable)} is unstable")
    return f"{how}, {'the flange is ' if len(unstable) < len(arms) else ''}{listed(stable)}"


def held(n: Numbers) -> str:
    values = [f"{p['name'].replace('_', ' ')} {significant(p['value'], 3)} {unit(p['unit'])}".strip() for p in n["parameters"]]
    return (
        f"The corrected arm holds {listed(values)} for {words(n['effect'], n.get('joint'))}: an arm folder cannot hold a lead of the torque reading or "
        "of dry friction, and predicts best with these values"
    )


def words(effect: str, joint: str | None) -> str:
    """An effect's name in words, with its joint."""
    first, *rest = effect.split("_")
    text = " ".join([first.capitalize() if first in PEOPLE else first, *rest])
    return f"{text} at {joint}" if joint else text


def residual_words(n: Numbers) -> str:
    """Residual RMS at a joint before and after the correction; with `healthy`, of what the healthy recordings do not explain."""
    beyond = " beyond the healthy recordings" if n["healthy"] else ""
    return (
        f"residual RMS{beyond} at {n['joint']} {significant(n['before'], 3)} -> {significant(n['after'], 3)} {unit(n['unit'])}"
    )


def quantity(parameter: Numbers) -> str:
    """`value ± std unit`, rounded to the standard deviation; or that it is not identifiable, and the value at which it is held."""
    if parameter.get("identifiable") is False:
        return f"not identifiable, held at {rounded(float(parameter['value']), None, str(parameter.get('unit', '')))}"
    return rounded(float(parameter["value"]), parameter.get("std"), str(parameter.get("unit", "")))


def variable(text: str) -> str:
    """`dq:elbow_joint` in words."""
    kind, _, joint = text.replace("*sign(dq)", ", by direction").partition(":")
    return VARIABLES.get(kind, kind) + (f" of {joint}" if joint else "")


def listed(names: Sequence[str]) -> str:
    """a, b and c."""
    return names[0] if len(names) == 1 else ", ".join(names[:-1]) + " and " + names[-1] if names else "nothing seen"


def _size(u: Numbers) -> str:
    return f"{significant(u['rms'], 3)} {unit(u['unit'])}"


def _touched(contacts: Sequence[Numbers]) -> str:
    when = [
        f"at {c['start']['value']:.2f} s for {c['duration']['value']:.2f} s" + (f" in {e['log']}" if e.get("log") else "")
        for e, c in ((e, e["parameters"]) for e in contacts)
    ]
    return f"Something touched the arm {listed(when)}; this is an event, not a property of the arm"


def _found(effects: Sequence[Numbers]) -> str:
    if len(effects) != 1:
        joints: dict[str, list[str]] = {}
        for e in effects:
            joints.setdefault(e["effect"], []).extend([e["joint"]] if e.get("joint") else [])
        found = [words(effect, listed(at) if at else None) for effect, at in joints.items()]
        text = "; ".join(found) if any(len(at) > 1 for at in joints.values()) else listed(found)
        return text + "".join(f"; {words(e['effect'], e.get('joint'))}{_or(e)}" for e in effects if e.get("others"))
    (e,) = effects
    values = ", ".join(f"{name.replace('_', ' ')} {quantity(p)}" for name, p in e["parameters"].items())
    by = [f"from the {e['measured_by']}"] if e.get("measured_by") else []
    by += [f"in {e['log']}"] if e.get("log") else []
    left = [residual_words(e["residual"])] if e.get("residual") else []
    sure = [f"confidence {e['confidence']:.0%}"] if e.get("confidence") is not None else []
    return f"{words(e['effect'], e.get('joint'))} ({'; '.join([values, *by, *left, *sure])}){_or(e)}"


def _or(e: Numbers) -> str:
    """The effects that may take the place of an effect, in words."""
    others = [words(o["effect"], o.get("joint")) for o in e.get("others", [])]
    return f", or {' or '.join(others)}: these recordings cannot decide" if others else ""


def _depending(variables: Sequence[str]) -> str:
    return f", depending on {listed([variable(v) for v in variables])}" if variables else ""
