"""Reading of YAML, the one place where it is done: what would unfold without end is refused before it does."""

import yaml

from irodori.core.errors import InputError

_MOST_BYTES = 1 << 18
#: Values of a file, its aliases and merge keys unfolded; no written one comes near, and more would be read for seconds.
_MOST_VALUES = 25_000
#: Aliases and merge keys of a file, as it is written.
_MOST_ALIASES = 1_000
_DEEPEST = 64
#: Letters of a number or a date: 1:30:00 is one to the base of 60, and a long one takes quadratic time.
_LONGEST_NUMBER = 64
#: The key that makes Snakemake take a configuration for a template of yte, with Python in it.
_TEMPLATE = "__use_yte__"
_MERGE, _TEXT = "tag:yaml.org,2002:merge", "tag:yaml.org,2002:str"
_ENDLESS = "blocks that unfold without end"


class _BoundedLoader(
    yaml.composer.Composer, yaml.cyaml.CParser, yaml.constructor.SafeConstructor, yaml.resolver.Resolver
):
    """A safe loader that refuses a key given twice, where YAML would let the last one win, and what would unfold.

    Text is taken apart by libyaml, which takes a fifth of the time; nodes are composed here, where they are counted.
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
        try:
            return super().construct_object(node, deep)
        except (ValueError, OverflowError, KeyError) as error:  # such as the date 2010-13-45
            raise yaml.constructor.ConstructorError(None, None, str(error), node.start_mark) from None


def _refuse_endless(root: yaml.Node) -> None:
    """Refuse a document whose aliases, each read in its place, make too many values; each node is looked at once.

    A merge key is an alias that copies keys, so that the same sum bounds it.
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
    """Read a YAML file of the package itself, some ten times faster than `read_yaml`, which guards against others'."""
    with open(path, "rb") as file:
        return yaml.load(file, Loader=yaml.CSafeLoader)


def read_yaml(path) -> dict:
    """Read one YAML file that holds a block of keys.

    Parameters
    ----------
    path : path
        Up to 256 KiB, 64 blocks deep, 1000 aliases and merge keys, and 25,000 values once these have unfolded.

    Raises
    ------
    InputError
        If the file is missing, larger than that, is not YAML (with the line), gives a key twice, is a template that
        runs code, or holds something else.
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
