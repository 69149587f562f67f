"""Pieces that several panels are made of."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

import bpy

from ..bridge.recovery import Recovery
from ..contract.protocol import Decision, Expected
from ..contract.text import duration
from ..contract.vocabulary import decision_title, stage_title


def property_column(layout: bpy.types.UILayout) -> bpy.types.UILayout:
    """A column in which names of properties stand left of their values."""
    column = layout.column()
    column.use_property_split = True
    column.use_property_decorate = False
    return column


def draw_sentence(context: bpy.types.Context, layout: bpy.types.UILayout, text: str, icon: str) -> None:
    """A text of any length, wrapped to the sidebar."""
    scale = context.preferences.system.ui_scale
    width = max(int((context.region.width - 60 * scale) / (6.5 * scale)), 16)
    column = layout.column(align=True)
    column.scale_y = 0.8
    for paragraph in text.splitlines():
        for line in textwrap.wrap(paragraph, width, break_long_words=True) or [""]:
            column.label(text=line, icon=icon)
            icon = "BLANK1"


def draw_plan(context: bpy.types.Context, layout: bpy.types.UILayout, plan: Sequence[Decision]) -> None:
    """What is modelled, and why, in a sub-panel; nothing where there is no plan."""
    if not plan:
        return
    header, body = layout.panel("DANTEW_plan", default_closed=True)
    header.label(text="Plan")
    if body is not None:
        for decision in plan:
            draw_sentence(context, body, f"{decision_title(decision.what)}: {decision.choice}", "DOT")
            draw_sentence(context, body, decision.reason, "BLANK1")


def draw_progress(context: bpy.types.Context, layout: bpy.types.UILayout, recovery: Recovery) -> None:
    """A running recovery: stage, time left, plan, and the button that cancels it."""
    progress, step = recovery.progress, recovery.progress.step
    title = stage_title(step.stage)
    layout.progress(factor=step.fraction, text=f"{title}  {step.fraction:.0%}" if step.total else title)
    column = layout.column(align=True)
    if progress.expected is not None:
        column.label(text=expectation(progress.expected), icon="INFO")
    number, stages = progress.stage_number
    if number:
        column.label(text=f"Stage {number} of {stages}")
    if step.seconds_left is not None:
        column.label(text=f"{duration(step.seconds_left)} left", icon="TIME")
    if progress.loss is not None:
        column.label(text=f"Loss {progress.loss:.4f}", icon="GRAPH")
    draw_plan(context, layout, progress.plan)
    if progress.silent:
        text = (
            f"No message from the backend for {duration(progress.silent)}. If this goes on, cancel the run."
        )
        draw_sentence(context, layout, text, "ERROR")
    stopping = recovery.process.cancelled
    row = layout.row()
    row.scale_y = 1.3
    row.enabled = not stopping
    row.operator("dantew.cancel", text="Stopping..." if stopping else "Cancel", icon="CANCEL")


def expectation(expected: Expected) -> str:
    """What is expected of a run, in one line: its whole time, and the quality that its preset reached on test objects."""
    reached = expected.albedo_psnr_after_gain
    quality = f"; {reached.mean:.0f} dB on test objects" if reached is not None else ""
    return f"About {duration(expected.total_seconds)}{quality}"
