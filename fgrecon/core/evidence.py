"""What else is known of one vehicle, given with its observation or with the call."""

from __future__ import annotations

from typing import Any

from fgrecon.core.checks import as_list
from fgrecon.core.vehicle_class import VehicleClass

Evidence = VehicleClass
"""What may be given as evidence."""


def as_evidence(given: Any) -> tuple[Evidence, ...]:
    """Evidence of any kinds as a tuple.

    Raises:
        InvalidInputError: It is no sequence of evidence.
    """
    return tuple(as_list("evidence", given, VehicleClass))
