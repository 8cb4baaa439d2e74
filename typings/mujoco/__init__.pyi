# MuJoCo 4 ships no stubs for its compiled names: everything in it is Any.
from typing import Any

def __getattr__(name: str) -> Any: ...
