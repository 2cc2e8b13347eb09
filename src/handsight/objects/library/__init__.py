"""Objects by name, in a folder or at a URL."""

from handsight.objects.library.facts import Facts
from handsight.objects.library.index import Entry, NoLibrary
from handsight.objects.library.library import Library, default_place

__all__ = ["Entry", "Facts", "Library", "NoLibrary", "default_place"]
