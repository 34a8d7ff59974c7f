"""What stands around the bytes of a batch in its file: a mark of the sweep, a check sum, and which batch it is."""

import hashlib

from .errors import DamagedBatchError

MARK = 16
"""The length of the mark with which a batch begins."""
_SUM, _LENGTH = 32, 2  # bytes of the check sum, and of the length of the name


BEGINNING = MARK + _SUM + _LENGTH + 255
"""How many bytes hold the mark and the name, for names as long as file systems take them."""


class ForeignBatchError(Exception):
    """A batch that is whole, and of another sweep."""


def sealed(mark: bytes, name: str, data: bytes) -> bytes:
    """The bytes of a batch as they stand in the file called `name`, whose name says what they are.

    The check sum is of the name too: under another name they are no batch.
    """
    claims = name.encode()
    rest = len(claims).to_bytes(_LENGTH, "big") + claims + data
    return mark + _sum(mark, rest) + rest


def unsealed(mark: bytes, name: str, whole: bytes) -> bytes:
    """The bytes that were sealed with this mark and name.

    Raises DamagedBatchError for bytes that are not as they were written, or were written under another name, and
    ForeignBatchError for those of another sweep.
    """
    found, stated, rest = whole[:MARK], whole[MARK : MARK + _SUM], whole[MARK + _SUM :]
    if stated != _sum(found, rest):
        raise DamagedBatchError("its check sum is wrong")
    if found != mark:
        raise ForeignBatchError
    claims, data = _claims(rest)
    if claims != name:
        raise DamagedBatchError(f"it is {claims}, under another name")
    return data


def claims_of(beginning: bytes) -> tuple[bytes, str]:
    """The mark of a batch, and its name when it was written, from its `BEGINNING`; nothing says that they are whole."""
    return beginning[:MARK], _claims(beginning[MARK + _SUM :])[0]


def _claims(rest: bytes) -> tuple[str, bytes]:
    end = _LENGTH + int.from_bytes(rest[:_LENGTH], "big")
    return rest[_LENGTH:end].decode(errors="replace"), rest[end:]


def _sum(mark: bytes, rest: bytes) -> bytes:
    return hashlib.sha256(mark + rest).digest()
