"""Reader of all YAML files, which refuses a file with aliases that would expand to too many values."""

import re

import yaml

from irodori.core.errors import InputError

_MOST_BYTES = 1 << 18
#: Most values of a file, with its aliases and merge keys expanded. No real file comes near; more would take seconds.
_MOST_VALUES = 25_000
#: Most aliases and merge keys of a file.
_MOST_ALIASES = 1_000
_DEEPEST = 64
#: Most characters of a number or a date. YAML reads 1:30:00 as a number in base 60; a long one takes quadratic time.
_LONGEST_NUMBER = 64
#: Key that makes Snakemake read a configuration as a template of yte, which may contain Python.
_TEMPLATE = "__use_yte__"
_MERGE, _TEXT = "tag:yaml.org,2002:merge", "tag:yaml.org,2002:str"
_NUMBERS = "tag:yaml.org,2002:int", "tag:yaml.org,2002:float"
#: Numbers that YAML reads in base 8 or 60, although nobody means that in a definition: 045 is 37, and 10:40 is 640.
_OTHER_BASE = re.compile(r"[-+]?0[0-9_]+|.*:.*")
_ENDLESS = "blocks that unfold without end"


class _BoundedLoader(
    yaml.composer.Composer, yaml.cyaml.CParser, yaml.constructor.SafeConstructor, yaml.resolver.Resolver
):
    """YAML loader that refuses duplicate keys, of which YAML keeps the last, and documents that are too large.

    The text is parsed by libyaml, which takes a fifth of the time. Nodes are composed in Python and counted there.
    """

    def __init__(self, stream) -> None:
        yaml.cyaml.CParser.__init__(self, stream)
        yaml.composer.Composer.__init__(self)
        yaml.constructor.SafeConstructor.__init__(self)
        yaml.resolver.Resolver.__init__(self)
        self._depth = self._nodes = self._aliases = 0

    def compose_node(self, parent, index):
        self._nodes += 1
        self._aliases += self.check_event(yaml.AliasEvent)
        self._depth += 1
        for count, most, what in (
            (self._depth, _DEEPEST, "blocks nested more than {} deep"),
            (self._nodes, _MOST_VALUES, "more than {} values"),
            (self._aliases, _MOST_ALIASES, "more than {} aliases"),
        ):
            if count > most:
                raise yaml.composer.ComposerError(None, None, what.format(most), self.peek_event().start_mark)
        node = super().compose_node(parent, index)
        self._depth -= 1
        return node

    def construct_document(self, node):
        _refuse_endless(node)
        return super().construct_document(node)

    def construct_mapping(self, node, deep=False):
        seen = set()
        for key_node, _ in node.value if isinstance(node, yaml.MappingNode) else ():
            if not isinstance(key_node, yaml.ScalarNode) or key_node.tag == _MERGE:
                continue
            if key_node.value in seen:
                raise yaml.constructor.ConstructorError(
                    None, None, f"the key {key_node.value!r} twice", key_node.start_mark
                )
            seen.add(key_node.value)
        return super().construct_mapping(node, deep)

    def construct_object(self, node, deep=False):
        if isinstance(node, yaml.ScalarNode) and node.tag != _TEXT and len(node.value) > _LONGEST_NUMBER:
            found = f"a number or a date of {len(node.value)} letters"
            raise yaml.constructor.ConstructorError(None, None, found, node.start_mark)
        if isinstance(node, yaml.ScalarNode) and node.tag in _NUMBERS and _OTHER_BASE.fullmatch(node.value):
            value = super().construct_object(node, deep)
            found = f"{node.value}, which YAML reads as {value:g}; without a leading zero or colon it is what it says"
            raise yaml.constructor.ConstructorError(None, None, found, node.start_mark)
        try:
            return super().construct_object(node, deep)
        except (ValueError, OverflowError, KeyError) as error:  # such as the date 2010-13-45
            raise yaml.constructor.ConstructorError(None, None, str(error), node.start_mark) from None


def _refuse_endless(root: yaml.Node) -> None:
    """Refuse a document that has too many values once its aliases are expanded. Each node is visited once.

    A merge key copies the keys of an alias, so that the same count bounds it.
    """
    values: dict[int, int] = {}
    open_nodes: set[int] = set()

    def count(node: yaml.Node) -> int:
        if id(node) in open_nodes:
            raise yaml.composer.ComposerError(None, None, f"{_ENDLESS}: an alias inside itself", node.start_mark)
        if id(node) not in values:
            open_nodes.add(id(node))
            if isinstance(node, yaml.MappingNode):
                total = 1 + sum(count(part) for pair in node.value for part in pair)
            else:
                total = 1 + sum(map(count, node.value)) if isinstance(node, yaml.SequenceNode) else 1
            if total > _MOST_VALUES:
                found = f"{_ENDLESS}: aliases that make more than {_MOST_VALUES} values"
                raise yaml.composer.ComposerError(None, None, found, node.start_mark)
            open_nodes.remove(id(node))
            values[id(node)] = total
        return values[id(node)]

    count(root)


def read_own_yaml(path) -> dict:
    """Read a YAML file of the package itself, about ten times as fast as `read_yaml`, which checks users' files."""
    with open(path, "rb") as file:
        return yaml.load(file, Loader=yaml.CSafeLoader)


def read_yaml(path) -> dict:
    """Read a YAML file with a mapping at its top level.

    Parameters
    ----------
    path : path
        File of at most 256 KiB, 64 nested blocks, 1000 aliases and merge keys, and 25,000 values after their expansion.

    Raises
    ------
    InputError
        If the file is missing, exceeds these limits, is not YAML (the message names the line), has a key twice, is a
        template that would run code, or has no mapping at its top level.
    """
    try:
        with open(path, "rb") as file:
            content = file.read(_MOST_BYTES + 1)
        if len(content) > _MOST_BYTES:
            raise InputError(
                path, "", f"more than {_MOST_BYTES} bytes", "a definition of a size that a person can read"
            )
        content = yaml.load(content, Loader=_BoundedLoader)
    except FileNotFoundError:
        raise InputError(path, "", "no such file", "a YAML file") from None
    except OSError as error:
        raise InputError(path, "", error.strerror or str(error), "a YAML file that can be read") from None
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = f"line {mark.line + 1}, column {mark.column + 1}" if mark else ""
        raise InputError(path, place, error.problem or error.context or "a fault", "YAML, each key once") from None
    except yaml.YAMLError as error:
        raise InputError(path, "", " ".join(str(error).split()), "YAML saved as UTF-8") from None
    if not isinstance(content, dict):
        found = "an empty file" if content is None else f"a {type(content).__name__}"
        raise InputError(path, "", found, "a block of keys")
    if _TEMPLATE in content:
        raise InputError(path, _TEMPLATE, "a template, whose expressions Snakemake would run", "plain YAML")
    return content
