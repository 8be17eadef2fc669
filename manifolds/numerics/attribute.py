"""Abstract attributes, which a subclass declares in whatever way suits it."""

import inspect
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar

T = TypeVar("T")


class _AbstractAttribute:
    """A placeholder of an attribute that a class requires, which a field of that name in a subclass hides."""

    __isabstractmethod__ = True

    def __init__(self, method: Callable[[Any], Any]) -> None:
        self.__doc__ = method.__doc__

    def __set_name__(self, owner: type, name: str) -> None:
        self._owner, self._name = owner, name

    def __get__(self, instance: object, owner: type) -> "_AbstractAttribute":
        # A dataclass takes what it finds under a field's name for the default, and an abstract class for not yet
        # declared.
        below = owner.__mro__[: owner.__mro__.index(self._owner)]
        if instance is not None or any(self._name in inspect.get_annotations(kind) for kind in below):
            raise AttributeError(f"{owner.__name__} has no {self._name}")
        return self


if TYPE_CHECKING:

    def attribute(method: Callable[[Any], T]) -> T | Any:
        """Declare an attribute by a method's name, return type and docstring, above ``abstractmethod``.

        A subclass has it as a class attribute, a dataclass field or a property. No type that a checker is told allows
        all three but ``Any``; beside it ``T`` is what is known of the value.
        """
        ...

else:
    attribute = _AbstractAttribute
