"""The formulas of GenICam descriptions (GenApi 2.1, section 2.8.10): parsed once, evaluated with variables."""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable, Mapping
from functools import cache, partial

Number = int | float
Variables = Callable[[str], Number]
Formula = Callable[[Variables], Number]

_TOKEN = re.compile(
    r"\s*(0[xX][0-9a-fA-F]+|(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|[A-Za-z_][\w.]*"
    r"|\*\*|<<|>>|<=|>=|<>|!=|==|&&|\|\||[-+*/%&|^~!?:()<>=,])"
)


def _divide(a: Number, b: Number) -> Number:
    if isinstance(a, float) or isinstance(b, float):
        return a / b
    return abs(a) // abs(b) * (1 if (a < 0) == (b < 0) else -1)


def _remainder(a: Number, b: Number) -> Number:
    return math.fmod(a, b) if isinstance(a, float) or isinstance(b, float) else abs(a) % abs(b) * (-1 if a < 0 else 1)


def _bits(function: Callable[[int, int], int]) -> Callable[[Number, Number], Number]:
    return lambda a, b: function(int(a), int(b))


def _shift_left(a: int, b: int) -> int:
    """Shift within 64 bits, the last of which is the sign."""
    shifted = a << (b & 63) & (1 << 64) - 1
    return shifted - (1 << 64) if shifted >> 63 else shifted


def _truth(function: Callable[[Number, Number], bool]) -> Callable[[Number, Number], Number]:
    return lambda a, b: int(function(a, b))


_LEVELS: tuple[Mapping[str, Callable[[Number, Number], Number]], ...] = (
    {"||": _truth(lambda a, b: bool(a or b))},
    {"&&": _truth(lambda a, b: bool(a and b))},
    {"|": _bits(operator.or_)},
    {"^": _bits(operator.xor)},
    {"&": _bits(operator.and_)},
    {"=": _truth(operator.eq), "==": _truth(operator.eq), "<>": _truth(operator.ne), "!=": _truth(operator.ne)},
    {"<": _truth(operator.lt), ">": _truth(operator.gt), "<=": _truth(operator.le), ">=": _truth(operator.ge)},
    {"<<": _bits(_shift_left), ">>": _bits(lambda a, b: a >> (b & 63))},
    {"+": operator.add, "-": operator.sub},
    {"*": operator.mul, "/": _divide, "%": _remainder},
    {"**": operator.pow},
)  # fmt: skip
"""Operators by precedence, the weakest first."""
_SIGNS: Mapping[str, Callable[[Number], Number]] = {
    "-": operator.neg, "+": operator.pos, "~": lambda a: ~int(a), "!": lambda a: int(not a),
}  # fmt: skip
_FUNCTIONS: Mapping[str, Callable[..., Number]] = {
    "SGN": lambda a: (a > 0) - (a < 0), "NEG": operator.neg, "ABS": abs, "EXP": math.exp, "LN": math.log,
    "LG": math.log10, "SQRT": math.sqrt, "TRUNC": math.trunc, "FLOOR": math.floor, "CEIL": math.ceil,
    "ROUND": lambda a, digits=0: math.floor(a * 10**digits + 0.5) / 10**digits, "SIN": math.sin, "COS": math.cos,
    "TAN": math.tan, "ASIN": math.asin, "ACOS": math.acos, "ATAN": math.atan,
}  # fmt: skip
_CONSTANTS = {"PI": math.pi, "E": math.e}


class FormulaError(ValueError):
    """A formula that cannot be parsed."""


@cache
def parse(text: str, *, real: bool = False) -> Formula:
    """Return a formula as a function of its variables; `real`: all its numbers are floats."""
    tokens, at = [], 0
    text = text.strip()
    while at < len(text):
        found = _TOKEN.match(text, at)
        if found is None:
            raise FormulaError(f"formula {text!r}: unexpected {text[at : at + 10]!r}.")
        tokens.append(found[1])
        at = found.end()
    parser = _Parser(text, tokens, float if real else int)
    formula = parser.choice()
    if parser.tokens:
        raise FormulaError(f"formula {text!r}: unexpected {parser.tokens[-1]!r}.")
    return formula


class _Parser:
    def __init__(self, text: str, tokens: list[str], kind: type[int | float]) -> None:
        self.text, self.tokens, self._kind = text, tokens[::-1], kind

    def choice(self) -> Formula:
        condition = self._binary(0)
        if not self._take("?"):
            return condition
        then = self.choice()
        self._expect(":")
        other = self.choice()
        return lambda v: then(v) if condition(v) else other(v)

    def _binary(self, level: int) -> Formula:
        if level == len(_LEVELS):
            return self._signed()
        left = self._binary(level + 1)
        while self.tokens and self.tokens[-1] in _LEVELS[level]:
            left = partial(_both, _LEVELS[level][self.tokens.pop()], left, self._binary(level + 1))
        return left

    def _signed(self) -> Formula:
        if self.tokens and self.tokens[-1] in _SIGNS:
            sign, inner = _SIGNS[self.tokens.pop()], self._signed()
            return lambda v: sign(inner(v))
        return self._atom()

    def _atom(self) -> Formula:
        if self._take("("):
            inside = self.choice()
            self._expect(")")
            return inside
        if not self.tokens:
            raise FormulaError(f"formula {self.text!r} ends too early.")
        token = self.tokens.pop()
        if token[0].isdigit() or token[0] == ".":
            number = number_of(token)
            number = float(number) if self._kind is float else number
            return lambda _: number
        if token in _FUNCTIONS and self._take("("):
            arguments = [self.choice()]
            while self._take(","):
                arguments.append(self.choice())
            self._expect(")")
            function = _FUNCTIONS[token]
            return lambda v: function(*(argument(v) for argument in arguments))
        if not (token[0].isalpha() or token[0] == "_"):
            raise FormulaError(f"formula {self.text!r}: unexpected {token!r}.")
        return lambda v: _variable(v, token)

    def _take(self, token: str) -> bool:
        if self.tokens and self.tokens[-1] == token:
            self.tokens.pop()
            return True
        return False

    def _expect(self, token: str) -> None:
        if not self._take(token):
            raise FormulaError(f"formula {self.text!r}: {token!r} is missing.")


def _variable(variables: Variables, name: str) -> Number:
    try:
        return variables(name)
    except KeyError:
        return _CONSTANTS.get(name, 0)  # Mako_U-029B names a variable that it does not declare


def _both(operation: Callable[[Number, Number], Number], left: Formula, right: Formula, variables: Variables) -> Number:
    return operation(left(variables), right(variables))


def number_of(text: str) -> Number:
    """Return a number as descriptions write it: decimal, hexadecimal or with a point."""
    text = text.strip()
    if text.lower().lstrip("+-").startswith("0x"):
        return int(text, 16)
    try:
        return int(text)
    except ValueError:
        return float(text)
