"""The command line: arguments in; a call of the library, a table and an exit status out."""

from __future__ import annotations

import _thread
import glob
import os
import re
import sys
import warnings
from collections.abc import Mapping, Sequence
from importlib import import_module
from inspect import cleandoc
from threading import Timer
from typing import Annotated, Any

import typer

from asterism.cli import _console, _first_compile, body, calibrate, garment, live_cameras, rig
from asterism.cli._plain_values import PlainValuesCommand, PlainValuesGroup
from asterism.cli._streams import StandardOutputError, guard_standard_streams
from asterism.errors import AsterismError

_RENAMED = {
    "--keep": "--keep-labels",
    "--anyway": "--force",
    "--weigh-from": "--weight-reference",
    "--mine-again": "--search-again",
    "--miner": "--partial-solvers",
}
"""Renamed options: the old name, which is accepted and no longer shown, and the new one."""
_LISTS = ("--occlusions", "--ghosts", "--wand")
_FILE_LISTS = ("--compare",)
"""Options to which all files belong that follow them, as a shell spells out `after/*.c3d`."""


def _show_version(wanted: bool) -> None:
    if wanted:
        from asterism import __version__

        print(f"asterism {__version__}")
        raise typer.Exit(0)


def _asterism(
    _version: Annotated[bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Print the version and stop.")] = False,
) -> None:
    pass


_EXAMPLES = {
    "demo": "asterism demo",
    "name": "asterism name first.c3d --report numbers.html",
    "train": "asterism train labelled/*.c3d -o gait.model --markers helen-hayes",
    "label": "asterism label raw/*.c3d --model gait.model -o labelled",
    "process": "asterism process people -o results",
    "review": "asterism review raw/*.c3d --model gait.model --report review.html",
    "learn": "asterism learn gait.model corrected/*.c3d -o better.model",
    "evaluate": "asterism evaluate --leave-one-subject-out labelled/*.c3d --markers helen-hayes --occlusions 0 2 4",
    "audit": "asterism audit labelled/*.c3d --markers helen-hayes",
    "mend": "asterism mend labelled/*.c3d --markers helen-hayes -o mended",
    "capturability": "asterism capturability labelled/*.c3d --markers helen-hayes --report capturability.html",
    "info": "asterism info walk.c3d",
    "convert": "asterism convert walk.c3d walk.trc",
    "warm-up": "asterism warm-up --markers plug-in-gait",
    "detect": "asterism detect cam1.mp4 cam2.mp4 cam3.mp4 -o 2d.csv --rig rig.toml --report blobs.html",
    "reconstruct": "asterism reconstruct 2d.csv --rig rig.toml -o clouds.npz",
    "segment": "asterism segment walk.c3d --report limbs.html",
    "motion": "asterism motion walk.c3d --uncertainty --report motion.html",
    "gait": "asterism gait walk*.c3d --static static.c3d --report gait.html",
    "events": "asterism events squats.c3d --rules squat",
    "skeleton": "asterism skeleton walk*.c3d --static static.c3d --table joints.csv",
    "opensim": "asterism opensim walk*.c3d --static static.c3d --model gait2392_simbody.osim -o opensim",
    "retarget": "asterism retarget walk.c3d --static static.c3d --character troll.glb -o troll_walks.glb",
    "live": "asterism live --replay walk.c3d --markers plug-in-gait -o labelled.c3d",
    "label-views": "asterism label-views 2d.csv --rig rig.toml --body gait15 -o labelled.c3d",
}
"""Each verb, which is a function in a module of its name, and its example."""
_HEADINGS = {
    "Every day": ("demo", "name", "train", "label", "process", "review", "learn", "evaluate", "info", "convert", "warm-up"),
    "Labels and marker sets under test": ("audit", "mend", "capturability"),
    "From your own cameras": ("detect", "calibrate", "reconstruct", "rig", "label-views", "body"),
    "While it happens": ("live",),
    "Movement": ("gait", "skeleton", "events", "segment", "motion", "opensim", "retarget"),
    "Garments": ("garment",),
}
"""The headings under which the help lists the commands."""
_GROUPS: dict[str, tuple[str, Mapping[str, str]]] = {
    "calibrate": ("Make the rig of a set of cameras, and correct it.", calibrate.EXAMPLES),
    "body": ("Make the model of a body; learn where markers sit on it.", body.EXAMPLES),
    "garment": ("Print coded garments, and capture a body that wears one.", garment.EXAMPLES),
    "rig": ("Show how exactly a rig measures; plan one.", rig.EXAMPLES),
}
"""The first words of commands with two words: their help, and their commands."""
_UNDER = {("live", "cameras"): ("List, set and watch cameras.", live_cameras.EXAMPLES)}
"""The first two words of commands with three, where the first alone is a command, too: their help, and their commands."""


def command_line(words: Sequence[str] = ()) -> typer.Typer:
    """The commands as Typer knows them: the one that these words name, and all of them where they name none.

    Only what is returned is imported, which is most of the time that a short command takes.
    """
    app = typer.Typer(
        name="asterism",
        cls=PlainValuesGroup,
        add_completion="_ASTERISM_COMPLETE" in os.environ,  # the options to install it would need the shell to be guessed
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    app.callback(
        help="Say which anonymous point of a motion capture is which marker. Start with `asterism demo`. From your own cameras' images: "
        "detect, calibrate, reconstruct; then name the markers of one recording, train, and label the others.",
        epilog="Status on leaving: 0 all done, 1 some files failed (named on standard error), 2 nothing could be done, 130 interrupted.",
    )(_asterism)
    first, second = [*words[:2], "", ""][:2]
    if (first, second) in _UNDER:
        help_, verbs = _UNDER[first, second]
        outer, group = typer.Typer(name=first, cls=PlainValuesGroup), typer.Typer(name=second, cls=PlainValuesGroup, help=help_)
        _register(group, f"{__name__}.{first}_{second}", verbs, words[2] if len(words) > 2 else "")
        outer.add_typer(group)
        app.add_typer(outer)
        return app
    # where the word is no command, all are needed for the help
    named = first in _EXAMPLES or first in _GROUPS
    if first not in _GROUPS:
        _register(app, __name__, _EXAMPLES, first)
    for name, (help_, examples) in _GROUPS.items():
        if name == first or not named:
            group = typer.Typer(name=name, cls=PlainValuesGroup, help=help_, rich_markup_mode=None)
            _register(group, f"{__name__}.{name}", examples, second)
            app.add_typer(group, rich_help_panel=_heading(name))
    return app


def _register(group: typer.Typer, package: str, examples: Mapping[str, str], word: str) -> None:
    """Add the verb of this name to a group of commands, or all verbs of a package where it has none of this name."""
    for verb in [word] if word in examples else examples:
        function = getattr(import_module(f"{package}.{_python_name(verb)}"), _python_name(verb))
        text, example = _paragraphs(function.__doc__ or ""), f"Example: {examples[verb]}"
        heading = _heading(verb) if package == __name__ else None
        group.command(name=verb, cls=PlainValuesCommand, help=text, epilog=example, rich_help_panel=heading)(function)


def _heading(word: str) -> str:
    return next(heading for heading, commands in _HEADINGS.items() if word in commands)


def _python_name(verb: str) -> str:
    """The name of a verb's module and function."""
    return verb.replace("-", "_")


def _paragraphs(text: str) -> str:
    return re.sub(r"(?<!\n)\n(?!\n)", " ", cleandoc(text))


def _show_warning(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
    """A warning that is written for a person as a sentence, without the line of source that Python adds to it."""
    if category is UserWarning:
        _console.notice(str(message))
    else:
        # of a library, for whoever looks for its cause
        _python_shows(message, category, *where, **more)


_python_shows = warnings.showwarning


def main(args: Sequence[str] | None = None) -> int:
    """Run one command line (by default the process') and return its exit status; see `asterism --help` for the meanings."""
    if args is None:
        guard_standard_streams()
    try:
        status = _run(args)
        if sys.stdout is not None:
            sys.stdout.flush()
        return status
    except BrokenPipeError:
        sys.stdout = None  # the reader is gone: nothing is left to flush at exit
        return 1
    except StandardOutputError as problem:
        sys.stdout = None
        _console.error(str(problem))
        return 2


def _run(args: Sequence[str] | None) -> int:
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            # a name that the terminal cannot show must not end the run
            stream.reconfigure(errors="replace")
    try:
        # old spellings first, so that the other two see the present ones
        words = _lists_joined(_globbed(_respelled(sys.argv[1:] if args is None else args)))
        if args is None:
            # only for a process of its own: a caller in Python has its own warnings
            _first_compile.prepare(words)
            warnings.showwarning = _show_warning
            sys.unraisablehook = _interrupted_elsewhere
        status = command_line(words)(args=words or ["--help"], prog_name="asterism", standalone_mode=False)
    except (BrokenPipeError, StandardOutputError):
        raise
    except AsterismError as problem:
        _console.error(str(problem))
        return 2
    except (KeyboardInterrupt, typer.Abort):
        status = 130
    except OSError as problem:
        _console.error(_console.reason(problem))
        return 2
    except Exception as problem:
        # neither ours nor Click's: a fault, whose place in the code is wanted
        if not hasattr(problem, "format_message"):
            import traceback

            traceback.print_exc()
            _console.error(_console.reason(problem))
            return 2
        _console.error(f"{problem.format_message().rstrip('.')}; `{_command_of(problem)} --help` shows what it takes.")
        return 2
    if status == 130:
        _console.error("interrupted; finished files stay, and no half-written file is left.")
    return status if isinstance(status, int) else 0


def _interrupted_elsewhere(lost: sys.UnraisableHookArgs) -> None:
    """Ctrl-C within a library's callback, as while kernels are loaded, is lost there: it is raised again where it ends the run."""
    if issubclass(lost.exc_type, KeyboardInterrupt):
        # from another thread, and a moment later: within this function it would be lost as well
        Timer(0.01, _thread.interrupt_main).start()
    else:
        sys.__unraisablehook__(lost)


def _command_of(problem: Exception) -> str:
    """The command whose words were not understood: `asterism label`."""
    path = getattr(getattr(problem, "ctx", None), "command_path", "")
    return path or "asterism"


def _respelled(args: Sequence[str]) -> list[str]:
    """The arguments with the present names of options in place of earlier ones; `--compare=a b` is `--compare a b`."""
    parts = ([_RENAMED.get(name, name), *value] for name, *value in (arg.split("=", 1) for arg in args))
    return [word for part in parts for word in (part if part[0] in _FILE_LISTS else ["=".join(part)])]


def _globbed(args: Sequence[str]) -> list[str]:
    """`*.c3d` becomes the files that match, for shells that leave this to the program."""
    return [path for arg in args for path in (sorted(glob.glob(arg)) if glob.has_magic(arg) and not os.path.exists(arg) else []) or [arg]]


def _lists_joined(args: Sequence[str]) -> list[str]:
    """`--occlusions 0 1 2` becomes `--occlusions 0,1,2`: all numbers that follow such an option belong to it.

    All files that follow `--compare` belong to it: it is repeated before each.
    """
    joined: list[str] = []
    of_a_list, of_files = False, ""
    for arg in args:
        of_files = arg if arg in _FILE_LISTS else "" if arg.startswith("-") else of_files
        if of_files and arg not in _FILE_LISTS:
            joined += [arg] if joined[-1] == of_files else [of_files, arg]
            continue
        number = re.fullmatch(r"\d*\.?\d+", arg) is not None
        if of_a_list and number and joined[-1] not in _LISTS:
            joined[-1] += f",{arg}"
            continue
        of_a_list = arg in _LISTS or (of_a_list and number)
        joined.append(arg)
    return joined
