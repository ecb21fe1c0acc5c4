"""Class of a vehicle, by its own or another program's name: evidence of its size."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from fgrecon.core.checks import as_finite
from fgrecon.core.choices import ClassScheme
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.settings import one_of

_ROUNDED = 1e-3  # by how much probabilities may exceed one


@dataclass(frozen=True, eq=False, init=False, repr=False)
class VehicleClass:
    """Which class of vehicle it is: its size is that of the class, or a mix where the class is not sure.

    Attributes:
        probabilities: Of each class, by its name in the scheme (whatever the case); or a single name for a class that
            is sure. What is missing to one is any class, as often as each is among all.
        scheme: Whose names these are; the package's own are `car`, `van`, `lorry`, `bus` and `tram`.
    """

    probabilities: Mapping[str, float]
    scheme: ClassScheme = ClassScheme.FGRECON

    def __init__(
        self, probabilities: Mapping[str, float] | str, scheme: ClassScheme | str = ClassScheme.FGRECON
    ) -> None:
        """Check the numbers; whether a scheme has the names is checked with the sizes of its classes.

        Raises:
            InvalidInputError: They are no probabilities, or there is no such scheme.
        """
        named = {probabilities: 1.0} if isinstance(probabilities, str) else probabilities
        fix = "Give a name, or probabilities by name that sum to at most one."
        if not isinstance(named, Mapping) or not named or not all(isinstance(name, str) for name in named):
            raise InvalidInputError("vehicle_class", probabilities, fix)
        numbers = as_finite("vehicle_class", list(named.values()), (len(named),), fix)
        if (numbers < 0.0).any() or numbers.sum() > 1.0 + _ROUNDED:
            raise InvalidInputError("vehicle_class", dict(named), fix)
        object.__setattr__(self, "probabilities", dict(zip(named, numbers.tolist(), strict=True)))
        object.__setattr__(self, "scheme", one_of(ClassScheme, "vehicle_class.scheme", scheme))

    def __repr__(self) -> str:
        """The names with their probabilities."""
        shares = ", ".join(f"{name} {value:.2f}" for name, value in self.probabilities.items())
        return f"{type(self).__name__}({shares}; {self.scheme.value})"
