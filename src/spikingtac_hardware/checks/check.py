"""All checks of a design."""

from __future__ import annotations

from spikingtac.errors import ConfigError
from spikingtac_hardware.checks.finding import Finding
from spikingtac_hardware.checks.mechanics import mechanical_findings
from spikingtac_hardware.checks.optical import lens_gap, optical_findings
from spikingtac_hardware.layout import Layout
from spikingtac_hardware.parameters.design import Design


def check_design(design: Design) -> tuple[Finding, ...]:
    """Return the findings of every check.

    Where the lens would reach into the window nothing can be said of the optics; these checks are
    then left out, since the gap's own finding fails.

    Example:
        >>> from spikingtac_hardware.parameters.design import load_design
        >>> all(finding.passed for finding in check_design(load_design()))
        True
    """
    layout = Layout(design)
    gap = lens_gap(layout)
    optical = optical_findings(layout) if gap.value > 0 else ()
    return (gap, *mechanical_findings(layout), *optical)


def require_sound(design: Design) -> tuple[Finding, ...]:
    """Return the findings of a design that passes every check.

    Raises:
        ConfigError: A check fails; gives the reason of each that does.
    """
    findings = check_design(design)
    failed = [finding for finding in findings if not finding.passed]
    if failed:
        reasons = "\n".join(f"  {finding.name}: {finding.reason}" for finding in failed)
        raise ConfigError(f"{len(failed)} of {len(findings)} checks of the design fail:\n{reasons}")
    return findings
