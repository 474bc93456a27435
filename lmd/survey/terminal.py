"""Text of a survey for a terminal."""

from functools import partial

import numpy as np

from lmd.core.words import few, labelled
from lmd.survey.results import distances_from_plan, far_from_plan, metrics, needing_photographs, tag_columns
from lmd.survey.survey import Survey

NOTICED = 0.01  # minimum floor of the corners' standard deviation that is printed, pixels
TURNS = ("a quarter turn clockwise", "half a turn", "a quarter turn counter-clockwise")
_few = partial(few, most=12)  # a function that lists at most 12 tags


def to_text(survey: Survey) -> str:
    """Lines for a terminal."""
    figures, found = metrics(survey), survey.found
    expected = int((survey.placed | survey.loose | np.isin(survey.ids, survey.known.ids)).sum())

    def both(name: str, factor: float = 1e3, digits: str = ".2g") -> str:
        low, high = (factor * figures[f"{name}/{share}"] for share in (50, 90))
        return f"{low:{digits}} (90 %: {high:{digits}})"

    lines = {
        "tags": f"{survey.placed.sum()} of {expected} placed",
        "frames": f"{len(found.frames)} of {len(survey.detected.times)}, with {found.used.sum()} sightings",
        "known to": f"{both('sigma')} mm beside each other, one standard deviation; a map of another such walk "
        f"would differ by {1e3 * figures['differs']:.2g} mm (median)",
    }
    if survey.detected.left_out:
        lines["frames"] += f"; {len(survey.detected.left_out)} were left out (survey.every)"
    if found.inflation > 1.0:
        text = f"{found.inflation:.1f} times as much as the noise of corners explains, which these figures count"
        lines["blocks"] = f"of time disagree {text}"
    lines |= _motion(survey)
    if "moved/50" in figures:
        lines["they hang"] = f"{both('moved', digits='.3g')} mm off their plan"
        away = 1e3 * distances_from_plan(survey)
        if far := [f"{survey.ids[k]} ({away[k]:.3g} mm)" for k in far_from_plan(survey)]:
            lines["they hang"] += f"; farthest: {_few(far)}: is the plan right there?"
    lines["corners"] = f"{both('error', 1.0)} pixels off"
    if found.floor > NOTICED:
        lines["corners"] += f", of which a standard deviation of {found.floor:.2g} is not the detector's"
    for number, camera in enumerate(survey.calibrated, 1):
        label = f" {number}" * (len(survey.calibrated) > 1)
        lines[f"camera{label}"] = camera.to_text()
        if not camera.is_fixed:
            lines[f"not fixed{label}"] = "the camera: photograph tags on several walls at once, also held upright"
    if "measured" in survey.localised:
        lines["held out"] = (
            f"{len(survey.localised['measured'].shifts)} frames: corners {both('held_out_error_measured', 1.0)}"
        )
        lines["held out"] += " pixels off by a map made from the others"
    if "planned" in survey.localised:
        lines["planned"] = f"by the planned map {both('held_out_error_planned', 1.0)} pixels off, and the camera"
        lines["planned"] += f" {both('held_out_shift_planned', digits='.3g')} mm elsewhere"
    if (stage := survey.interrupted) is not None:
        lines["interrupted"] = f"told to stop while {stage.value}; " + (
            "what comes after that is left out" if stage.has_final_map else "the map is not final"
        )
    lines |= {label: text for label, text in _troubles(survey).items() if text}
    return labelled(lines)


def _motion(survey: Survey) -> dict[str, str]:
    """Lines on the motion between frames and on the groups that it joins."""
    motion, joined = survey.found.prior.motion, survey.joined
    if motion is None:
        return {}
    turn, place = (1e3 * spread for spread in motion.spread)
    by = "it" if motion.is_odometry else "motion"
    if motion.is_odometry:
        lines = {"odometry": f"drifts {place:.2g} mm and {turn:.2g} mrad within a metre, as the drive tells"}
    else:
        changes = f"the velocity changes by {place:.2g} mm/s and {turn:.2g} mrad/s within a second, as the drive tells"
        lines = {"motion": f"{changes}; frames up to {motion.longest:.2g} s apart are linked"}
    if joined is not None and len(joined.sigma) > 1:
        low, high = (1e3 * np.quantile(joined.sigma, share) for share in (0.5, 0.9))
        known = f"known to {low:.2g} (90 %: {high:.2g}) mm beside the nearest of another"
        lines["joined"] = f"{len(joined.sigma)} groups of tags that no image connects, by {by} alone: {known}"
    return lines


def _troubles(survey: Survey) -> dict[str, str]:
    """Texts on faults and missing photographs by kind; empty for kinds that do not occur."""
    ids, times, faults, state = survey.ids.tolist(), survey.detected.times, survey.faults, tag_columns(survey)["state"]
    by_state: dict[str, list[int]] = {}
    for number, text in zip(ids, np.asarray(state).tolist(), strict=True):
        by_state.setdefault(text, []).append(number)
    sigma = survey.found.sigmas
    unplanned = survey.placed & ~np.isin(survey.ids, survey.known.ids) & (survey.known.plan is not None)
    moved = [place for place in faults.second_places if place.moved is not None]
    copies = survey.detected.copies
    worst = [f"{ids[k]} ({1e3 * sigma[k]:.2g} mm)" for k in needing_photographs(survey) if survey.placed[k]]
    return {
        **{text: _few(numbers) for text, numbers in by_state.items() if text != "placed"},
        "turned": _turned(survey),
        "fixed": _off_fixed(survey),
        "not planned": _few(survey.ids[unplanned].tolist()),
        "moved": _few(f"{ids[place.tag]} from {times[place.moved or 0]} on" for place in moved),
        "twice": _few(ids[place.tag] for place in faults.second_places if place.moved is None),
        "other size": _few(f"{ids[tag]} ({1e3 * edge:.4g} mm)" for tag, edge in faults.sizes.items()),
        "blurred": _few(f"{name} ({pixels:.2g} pixels)" for name, pixels in survey.detected.blurred.items()),
        "copies": f"{len(copies)} images, not counted: such as {next(iter(copies))} of {next(iter(copies.values()))}"
        if copies
        else "",
        "misread": _few(f"{ids[k]} ({faults.misread[k]} x)" for k in np.flatnonzero(faults.misread)),
        "check": " ".join(survey.doubts),
        "photograph": _few(worst) + "; known worst" * bool(worst),
    }


def _turned(survey: Survey) -> str:
    """Tags that are turned beside their plan, and the treatment of their turns."""
    turns = survey.turns
    shown = np.bincount(survey.found.sightings.tag, minlength=len(survey.ids)) > 0
    hung = np.where(turns.beside_plan, turns.beside_plan, turns.beside_sheets)
    parts = [
        f"{words}: {_few(survey.ids[own])}; {made}"
        for made, by in (("their corners are renumbered", turns.renumbered), ("they hang so in the map", hung))
        for quarters, words in enumerate(TURNS, 1)
        if (own := (by == quarters) & shown).any()
    ]
    return ". ".join(parts)


def _off_fixed(survey: Survey) -> str:
    """Errors of fixed tags."""
    away = zip(survey.ids.tolist(), survey.off_fixed.tolist(), strict=True)
    texts = [
        f"{number} ({f'{1e3 * metres:.2g} mm' if metres == metres else f'{np.degrees(rad):.2g} degrees'})"
        for number, (metres, rad) in away
        if metres == metres or rad == rad
    ]
    return _few(texts) + "; elsewhere in the photographs: is the file exact, and each edge right?" * bool(texts)
