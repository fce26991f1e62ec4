"""What all sections of the configuration have in common, and the kinds of numbers in them."""

from __future__ import annotations

import math
from typing import Annotated, Any, get_args, get_origin

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, model_validator
from pydantic_core import InitErrorDetails, PydanticCustomError

LEAST, MOST = 1e-9, 1e9
"""Of a number that must not be 0, and of any: squares and quotients of what lies beyond may be 0 or overflow, in flight."""


def _no_smaller(value: float) -> float:
    if value < LEAST:
        raise ValueError(f"nothing can be computed with less than {LEAST:g}")
    return value


Positive = Annotated[float, Field(gt=0), AfterValidator(_no_smaller)]
NonNegative = Annotated[float, Field(ge=0)]
Share = Annotated[float, Field(gt=0, lt=1)]


class Section(BaseModel):
    """Base of all sections: frozen, no unknown keys, no number that is none (TOML has nan and inf; neither true nor a text that
    looks like a number is one, and no text is true)."""

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True, allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _each_of_its_kind(cls, data: Any) -> Any:
        stated = [item for item in data.items() if item[0] in cls.model_fields] if isinstance(data, dict) else []
        wrong = [
            InitErrorDetails(type=PydanticCustomError("kind", "{told}", {"told": problem}), loc=(name,), input=value)
            for name, value in stated
            if (problem := _of_another_kind(cls.model_fields[name].annotation, value))
        ]
        if wrong:
            raise ValidationError.from_exception_data(cls.__name__, wrong)
        return data


def _of_another_kind(annotation: Any, value: Any) -> str | None:
    """What is wrong with a value, or one of a list, that pydantic would take for the field's type, or name by its own types'
    names; None elsewhere."""
    if isinstance(annotation, type) and issubclass(annotation, Section):
        return None if isinstance(value, dict | Section) else "it is a section: its keys stand below a line [NAME]"
    if get_origin(annotation) is tuple and not isinstance(value, list | tuple):
        return "it is a list: write it in brackets, [ ]"
    for item in value if isinstance(value, list | tuple) else (value,):
        if isinstance(item, bool) and not _takes(annotation, bool):
            return f"{str(item).lower()} is no value for it"
        if isinstance(item, str) and not _takes(annotation, str):
            return "a text is no value for it: write numbers, true and false without quotes"
        if isinstance(item, int | float) and _takes(annotation, float) and MOST < abs(item) < math.inf:
            return f"nothing can be computed with more than {MOST:g}"
    return None


def _takes(annotation: Any, kind: type) -> bool:
    """Whether a field's type is `kind`, one of its values (Literal), or has it among its parts."""
    return annotation is kind or isinstance(annotation, kind) or any(_takes(part, kind) for part in get_args(annotation))
