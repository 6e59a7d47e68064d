"""Shorter sequences for a quick run: the same scenes, cut after their first motions."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from spikingtac.sim.scene.motions import IndenterMotion
from spikingtac.sim.scene.scene import ContactConfig, Scene


def shortened(scene: Scene, motion_s: float) -> Scene:
    """Return the scene with the motions of the first ``motion_s`` seconds, then the release.

    The rest before the first contact and after the last one stays whole, so that every metric keeps
    its meaning.

    Args:
        scene: A scene of the catalogue.
        motion_s: Motions that begin later are left out, s.
    """
    return replace(scene, contacts=tuple(_first(scene.contacts, motion_s)))


def _first(contacts: tuple[ContactConfig, ...], motion_s: float) -> Iterator[ContactConfig]:
    begun_s = 0.0
    for contact in contacts:
        if begun_s >= motion_s:
            return
        motion = IndenterMotion(contact.motion)
        *before, release = contact.motion.segments
        starts_s = motion.segment_starts_s[: len(before)]
        kept = [one for one, at in zip(before, starts_s, strict=True) if begun_s + at < motion_s]
        once_s = motion.duration_s + contact.pause_s
        repeats = min(contact.repeats, max(1, int((motion_s - begun_s) / once_s)))
        shorter = replace(contact.motion, segments=(*kept, release))
        yield replace(contact, motion=shorter, repeats=repeats)
        begun_s += contact.repeats * once_s
