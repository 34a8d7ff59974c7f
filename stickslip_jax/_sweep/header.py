"""The header of a batch's file: the identity of the sweep, a check sum, and the name under which it was written."""

import hashlib

from .errors import DamagedBatchError

ID_LENGTH = 16
"""The length of the identity of a sweep, with which the file of a batch begins."""
_SUM, _LENGTH = 32, 2  # bytes of the check sum, and of the length of the name


LONGEST_HEADER = ID_LENGTH + _SUM + _LENGTH + 255
"""How many bytes hold the header, for names as long as file systems take them."""


class ForeignBatchError(Exception):
    """A batch that is whole, and of another sweep."""


def with_header(sweep_id: bytes, name: str, data: bytes) -> bytes:
    """The bytes of a batch as they stand in the file called `name`, whose name says what they are.

    The check sum covers the name too: under another name they are no batch.
    """
    encoded = name.encode()
    rest = len(encoded).to_bytes(_LENGTH, "big") + encoded + data
    return sweep_id + _sum(sweep_id, rest) + rest


def without_header(sweep_id: bytes, name: str, whole: bytes) -> bytes:
    """The bytes that were written with this identity and name.

    Raises:
        DamagedBatchError: For bytes that are not as they were written, or were written under another name.
        ForeignBatchError: For those of another sweep.
    """
    found, stated, rest = whole[:ID_LENGTH], whole[ID_LENGTH : ID_LENGTH + _SUM], whole[ID_LENGTH + _SUM :]
    if stated != _sum(found, rest):
        raise DamagedBatchError("its check sum is wrong")
    if found != sweep_id:
        raise ForeignBatchError
    written, data = _name_and_data(rest)
    if written != name:
        raise DamagedBatchError(f"it is {written}, under another name")
    return data


def id_and_name(beginning: bytes) -> tuple[bytes, str]:
    """The identity of the sweep and the name when it was written, from the `LONGEST_HEADER` bytes at the beginning.

    They are not checked.
    """
    return beginning[:ID_LENGTH], _name_and_data(beginning[ID_LENGTH + _SUM :])[0]


def _name_and_data(rest: bytes) -> tuple[str, bytes]:
    end = _LENGTH + int.from_bytes(rest[:_LENGTH], "big")
    return rest[_LENGTH:end].decode(errors="replace"), rest[end:]


def _sum(sweep_id: bytes, rest: bytes) -> bytes:
    return hashlib.sha256(sweep_id + rest).digest()
