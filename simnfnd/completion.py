"""What a shell offers when Tab is pressed: verbs, and the keys, groups and choices of theirs.

    eval "$(simnfnd --shell-completion bash)"
    simnfnd --shell-completion fish | source

The scripts ask `simnfnd --complete -- WORDS`, which imports no more than it must.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from .verbs import VERBS, Verb

_BASH = r"""
_simnfnd() {
  local line="${COMP_LINE:0:COMP_POINT}" current one
  local -a words
  read -ra words <<< "$line"
  [[ $line == *[[:space:]] ]] && words+=("")
  current="${words[-1]}"
  local IFS=$'\n'
  COMPREPLY=($(simnfnd --complete -- "${words[@]:1}" 2>/dev/null))
  # Where the shell breaks words at `=`, it wants what follows it.
  if [[ $current == *=* && $COMP_WORDBREAKS == *=* ]]; then
    COMPREPLY=("${COMPREPLY[@]#"${current%"${current##*=}"}"}")
  fi
  for one in "${COMPREPLY[@]}"; do
    [[ $one == *[=.] ]] && compopt -o nospace 2>/dev/null
  done
  return 0
}
complete -o default -F _simnfnd simnfnd
"""

_ZSH = r"""
_simnfnd() {
  local -a found open
  found=("${(@f)$(simnfnd --complete -- "${(@)words[2,CURRENT]}" 2>/dev/null)}")
  found=(${found:#})
  if (( ! $#found )); then
    compset -P '*='
    _files
    return
  fi
  open=(${(M)found:#*[=.]})
  found=(${found:#*[=.]})
  compadd -S '' -- $open
  compadd -- $found
}
(( $+functions[compdef] )) || { autoload -Uz compinit && compinit }
compdef _simnfnd simnfnd
"""

_FISH = r"""
function __simnfnd_complete
  set -l current (commandline -ct)
  set -l words (commandline -opc) "$current"
  set -l found (simnfnd --complete -- $words[2..-1] 2>/dev/null)
  if test (count $found) -gt 0
    printf '%s\n' $found
  else if string match -q -- '*=*' $current
    set -l key (string replace -r '=.*' '=' -- $current)
    printf "$key%s\n" (__fish_complete_path (string replace -r '^[^=]*=' '' -- $current))
  else
    __fish_complete_path $current
  end
end
complete -c simnfnd -f -a '(__simnfnd_complete)'
"""

SCRIPTS = {"bash": _BASH, "zsh": _ZSH, "fish": _FISH}
"""Shell -> the script that teaches it."""


def script(shell: str) -> str:
    """The script of a shell.  Raises FactoryError for another one."""
    from .factory.errors import FactoryError

    name = shell.removeprefix("install=")
    if name not in SCRIPTS:
        raise FactoryError(
            f"--shell-completion {shell}: choose bash, zsh or fish, for example "
            'eval "$(simnfnd --shell-completion bash)"'
        )
    return SCRIPTS[name].strip()


def complete(words: Sequence[str]) -> list[str]:
    """What may stand in the place of the last word; nothing where files may."""
    *before, current = words or [""]
    if not before:
        return _begun(current, [*VERBS, "--help", "--version"])
    verb, deeper = VERBS.get(before[0]), 1
    if verb is None:
        return []
    own: Iterable[str] = ()
    if len(before) > 1 and before[1] in verb.verbs:
        verb, deeper = verb.verbs[before[1]], 2
    elif len(before) == 1:
        own = verb.verbs
    options = ["--help", *(["--multirun"] if verb.config == "factory" else [])]
    found = _begun(current, [*own, *(options if current.startswith("-") else [])])
    given = {word.partition("=")[0] for word in before[deeper:]}
    return found + (_settings(current, verb, given) if verb.config else [])


def _settings(current: str, verb: Verb, given: set[str]) -> list[str]:
    """Groups, and keys up to their next dot; behind `=` the choices, or true and false."""
    from .factory.cli.nearest import catalogue

    known = catalogue(verb.config)
    key, equals, _ = current.partition("=")
    if equals:
        switch = ["true", "false"] if isinstance(known.values.get(key), bool) else []
        return _begun(current, (f"{key}={one}" for one in known.groups.get(key, switch)))
    places = [f"{group}=" for group in known.groups if group not in given]
    for name in known.keys:
        step = name.find(".", len(current)) if name.startswith(current) else -1
        places.append(name[: step + 1] if step >= 0 else f"{name}=")
    return _begun(current, places)


def _begun(current: str, names: Iterable[str]) -> list[str]:
    return sorted({name for name in names if name.startswith(current)})
