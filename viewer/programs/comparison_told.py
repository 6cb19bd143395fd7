"""What ``compare-impostors`` says when it has compared: a table of errors and frame times, and what else there was."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from mmi.foundation.errors import one_line

if TYPE_CHECKING:
    from rich.console import Console

__all__ = ["print_comparison"]


def print_comparison(report: dict[str, Any], out: Path) -> None:
    """The table, what was held and what moved, and where the report is."""
    from rich.console import Console
    from rich.table import Table

    talk = Console(highlight=False, markup=False, emoji=False)
    if not talk.is_terminal:
        talk = Console(highlight=False, markup=False, emoji=False, width=120)
    title = f"{one_line(report['source']['name'])}: {report['views']} views at {report['display']['width']} x "
    title += f"{report['display']['height']}, drawn by {report['device']}"
    table = Table(title=title, title_justify="left", title_style="", box=None, pad_edge=False)
    table.add_column("technique", no_wrap=True)
    for heading in ("holes %", "wrong %", "thickness px", "displacement px", "FLIP", "PSNR", "SSIM", "frame ms"):
        table.add_column(heading, justify="right", no_wrap=True)
    for name, one in report["techniques"].items():
        thick, moved, frame = one["wrong_thickness_px"], one["displacement_px"], one["frame_ms"]
        times = f"{frame['p50']:.1f} / {frame['p99']:.1f}"
        if name == report["reference"]:
            table.add_row(name, "-", "-", "-", "-", "-", "-", "-", times)
            continue
        table.add_row(
            name,
            f"{100.0 * one['hole_share']:.3f}",
            f"{100.0 * one['wrong_share']:.3f}",
            f"{thick['p50']:.0f} / {thick['p99']:.0f} / {thick['max']:.0f}",
            f"{moved['p50']:.1f} / {moved['p99']:.1f} / {moved['max']:.1f}",
            "-" if one["flip"] is None else f"{one['flip']['mean']:.4f}",
            "equal" if one["psnr_db"] is None else f"{one['psnr_db']:.1f} / {one['psnr_worst_db']:.1f}",
            f"{one['ssim']:.4f}",
            times,
        )
    talk.print(table)
    note = "thickness and displacement: p50 / p99 / max; PSNR: mean / worst; frame: p50 / p99; - is not measured"
    talk.print(note, style="dim")
    _print_promise(report["source"], talk)
    _print_settling(report, talk)
    _print_rays(report, talk)
    _print_boxes(report, talk)
    _print_placed(report, talk)
    _print_movers(report, talk)
    talk.print(one_line(str(out / "report.html")), soft_wrap=True)
    if report["verdict"] is not None:
        talk.print(report["verdict"]["line"], soft_wrap=True)


def _print_promise(source: dict[str, Any], talk: Console) -> None:
    """What the dataset's threshold comes to on another display than the one that it was built for."""
    built = source["built_for"]
    if built is None or built["max_error_px"] == source["max_error_px"]:
        return
    text = f"built for {built['max_error_px']:g} px of {built['width']} x {built['height']} at {built['fov_deg']:g} degrees, "
    text += f"which are {source['max_error_px']:.1f} px in the middle of these pictures; "
    if not source["promising_cells"]:
        text += "no cell promises it"
    elif source["promised_px"] is None:
        text += "these see farther, and nothing is promised of how thick wrong regions are"
    else:
        text += f"promised: no wrong region thicker than {source['promised_px']:.1f} px"
    talk.print(text, soft_wrap=True)


def _print_settling(report: dict[str, Any], talk: Console) -> None:
    """After how many frames views were like the geometry, where they were held."""
    held = {name: one["settling"] for name, one in report["techniques"].items() if one["settling"] is not None}
    if not held:
        return
    layers = next(iter(held.values()))["layers"]
    have = "" if layers is None else f", and have {layers['p50']:g} / {layers['max']:g} layers"
    talk.print(f"\nviews that were held for {report['held_frames']} frames{have}:")
    for name, one in held.items():
        later = "" if layers is None else f", {one['later_than_layers']} after more frames than layers"
        talk.print(
            f"  {name}: {_frames_told('like the geometry', one['alike_frames'])}, {one['unlike']} not{later}; "
            f"{_frames_told('settled', one['settled_frames'])}, {one['unsettled']} not",
            soft_wrap=True,
        )
    note = "frames: p50 / p99 / max of the views that came there"
    talk.print(note if layers is None else f"{note}; layers: p50 / max", style="dim")


def _frames_told(what: str, after: dict[str, float] | None) -> str:
    return (
        f"none {what}"
        if after is None
        else f"{what} after {after['p50']:g} / {after['p99']:.3g} / {after['max']:g} frames"
    )


def _print_rays(report: dict[str, Any], talk: Console) -> None:
    """What pixels were, where a technique casts rays."""
    for name, entry in report["techniques"].items():
        one = entry["rays"]
        if one is None:
            continue
        shares = ("covered", "sky", "reused", "hit", "missed")
        told = ", ".join(f"{100.0 * one[f'{share}_share']:.2f} % {share}" for share in shares)
        late = 100.0 * (one["late_share"] + one["unknown_share"])
        talk.print(
            f"\n{name}, pixels of a frame: {told}"
            + (f", {late:.2f} % without the ray that they need" if late else "")
            + f"; {one['cast']:.0f} rays; what was shown again was off by {one['kept_px']:.1f} px at most"
            + (" (a bound)" if one["reuse"] == "bound" else " (where its own surface is)"),
            soft_wrap=True,
        )


def _print_boxes(report: dict[str, Any], talk: Console) -> None:
    """What boxes were, where a technique caches images of them."""
    for name, entry in report["techniques"].items():
        one = entry["boxes"]
        if one is None:
            continue
        late = f", {one['late']:.1f} late" if one["late"] else ""
        talk.print(
            f"\n{name}, boxes of a frame: {one['new']:.1f} new images, {one['combined']:.1f} combined, "
            f"{one['reused']:.1f} kept{late}, {one['impossible']:.1f} as geometry; "
            f"what was shown was off by {one['kept_px']:.2f} px at most (a bound); {one['bytes'] / 1e6:.0f} MB of images",
            soft_wrap=True,
        )


def _print_placed(report: dict[str, Any], talk: Console) -> None:
    """What frames were, where a technique shows placed images."""
    for name, entry in report["techniques"].items():
        one = entry["placed"]
        if one is None:
            continue
        others = [
            f"{100 * one[key]:.0f} % {told}"
            for key, told in (("outside_share", "from outside of the grid"), ("tilted_share", "tilted or too wide"))
            if one[key]
        ]
        talk.print(
            f"\n{name}, frames: {100 * one['image_share']:.0f} % with an image of {one['samples']:,.0f} samples; at most "
            f"{one['most_triangles']:,} triangles of {one['budget']:,}"
            + (f"; BROKEN in {one['over_budget']} frames" if one["over_budget"] else "")
            + (f"; not counted are {', '.join(others)}, which are drawn as geometry" if others else ""),
            soft_wrap=True,
        )


def _print_movers(report: dict[str, Any], talk: Console) -> None:
    """How what moves was drawn, where something does."""
    if report["movers"] is None:
        return
    source = one_line(report["movers"]["source"])
    talk.print(f"\n{report['movers']['objects']} moving objects of {source}, in a frame's view:")
    for name, entry in report["techniques"].items():
        one = entry["movers"]
        images = f"{one['captured'] + one['reused']:.1f} as images"
        if one["valid_frames"] is not None:
            images += f", which last {one['valid_frames']:.1f} frames"
        talk.print(f"  {name}: {one['geometry']:.1f} as geometry, {one['hidden']:.1f} hidden, {images}")
