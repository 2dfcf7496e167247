# SPDX-License-Identifier: Apache-2.0
"""Exceptions that keep their attributes when another process raises them."""

from __future__ import annotations

from typing import Any, TypeVar

E = TypeVar("E", bound=BaseException)


class Picklable(Exception):
    """Base of exceptions whose constructor takes other arguments than the message.

    By default, unpickling calls the constructor with the finished message.
    """

    def __reduce__(self) -> tuple[Any, ...]:
        return _restored, (type(self), self.args), self.__dict__


def _restored(kind: type[E], args: tuple[Any, ...]) -> E:
    error = kind.__new__(kind)
    error.args = args
    return error
