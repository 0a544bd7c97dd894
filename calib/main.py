"""The program `calib`: the explicit list of its commands, and the one place where errors become exit codes."""

from __future__ import annotations

import errno
import os
import sys
from importlib import import_module
from keyword import iskeyword
from typing import Annotated, Any

import typer
from typer.main import get_command

from calib.run_folder import INVOCATION, Invocation, conclude, end_run
from calib.terminal import answer, console
from calib.terminal.group import QUIET, Group
from calib.terminal.unexpected import EXIT_CODE, quiet_libraries, write_fault
from sim.errors import CalibError, ConfigError
from sim.first_use import announce
from sim.resources import nearest
from sim.version import software_version

# names on the command line; the module of each in calib.commands has a function `command`, or `app` with subcommands
COMMANDS = (
    "demo", "init", "go", "check", "plan", "record", "identify", "validate", "diagnose", "polish", "watch", "fleet",
    "export", "import", "replay", "report", "runs", "effects", "emulate", "capture", "arm", "servo", "help",
)  # fmt: skip

# the matrices here are small: a multithreaded BLAS spends two thirds of its processor time waiting
ONE_THREAD = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
HELP = {"help_option_names": ["-h", "--help"]}
MOST_HINTS = 3
# errors of a file or its disk that the operator can resolve; any other OSError is a fault of the program
OF_FILES = {
    errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EACCES, errno.EPERM, errno.EIO, errno.ENOENT, errno.ENOTDIR, errno.EISDIR,
    errno.ENAMETOOLONG,
}  # fmt: skip


def module_of(name: str) -> str:
    """The module of a command; a name that is a Python keyword gets a trailing _."""
    return f"calib.commands.{name}{'_' * iskeyword(name)}"


class Commands(Group):
    """Imports a command only when it is needed: completion and `calib effects` need not wait for a physics engine."""

    def list_commands(self, ctx: Any) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: Any, name: str) -> Any:
        if name not in COMMANDS:
            return None
        module = import_module(module_of(name))
        single = getattr(module, "app", None)
        if single is None:
            single = typer.Typer(rich_markup_mode=None, add_completion=False, context_settings=HELP)
            single.command(name)(module.command)
        command = get_command(single)
        command.name, command.epilog = name, QUIET
        for each in (command, *getattr(command, "commands", {}).values()):
            # examples are copied from the screen, so they must not be wrapped
            each.help = (each.help or "").replace("\n\n    calib ", "\n\n\b\n    calib ")
        lists, parse = getattr(module, "LIST_OPTIONS", ()), command.parse_args
        setattr(command, "parse_args", lambda ctx, args: parse(ctx, spread(args, lists)))  # noqa: B010
        return command

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:  # Typer would exit with a bare exit code and no reason
            raise typer.Abort from None
        except BrokenPipeError:  # of standard error; Typer would exit, and the run would have no recorded end
            conclude("the reader of the output has gone")
            raise typer.Exit(answer.GONE) from None


def spread(arguments: list[str], lists: tuple[str, ...]) -> list[str]:
    """`--holdout a b c` as `--holdout a --holdout b --holdout c`, for the options named in `lists`.

    ConfigError for an option without a value: an empty shell variable must not drop the option.
    """
    out: list[str] = []
    option, bare = "", ""
    for word in [*arguments, "--"]:
        if word in lists or word.startswith("-"):
            if bare:
                raise ConfigError(f"{bare}: no file is named; name at least one, or leave {bare} out")
            option = bare = word if word in lists else ""
            out += [] if option else [word]
        else:
            out += [option, word] if option else [word]
            bare = ""
    return out[:-1]


app = typer.Typer(
    name="calib",
    cls=Commands,
    help="Make a simulated robot arm move like the real one: record, identify, validate, and find the physical effect that the model is missing.",
    epilog="Every command has --help with an example, and --quiet, which prints only warnings and errors. `calib help` shows a cheat "
    "sheet. NO_COLOR is respected. Exit codes: 0 done, 1 the answer is no, 2 usage, configuration or data, "
    "3 safety stop, 4 device, 70 a fault of the program, 130 interrupted, 141 the reader of the output has gone.",
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings=HELP,
)


def _version(wanted: bool) -> None:
    if wanted:
        console.say(software_version())
        raise typer.Exit


@app.callback()
def _program(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    pass


def main(arguments: list[str] | None = None) -> int:
    """Run the program and return its exit code; an error is printed as a sentence and written into the run's folder."""
    if arguments is None:
        os.environ.setdefault("PYTHONWARNINGS", "ignore")  # for child processes
        for name in ONE_THREAD:  # read once, when NumPy is imported
            os.environ.setdefault(name, "1")
        announce(console.warn)
        with answer.replaced():
            return start(sys.argv[1:])[0]
    return start(list(arguments))[0]


def start(arguments: list[str]) -> tuple[int, str]:
    """Like `main`; return the exit code and the sentence with the outcome."""
    outer = INVOCATION.get()
    arguments, wanted = _quiet(arguments)
    invocation = Invocation(arguments, is_step=outer is not None and bool(outer.folders))
    token = INVOCATION.set(invocation)
    quiet = console.QUIET.set(wanted or console.QUIET.get())
    try:
        with quiet_libraries():
            code, sentence = _run(arguments, invocation)
        for folder in invocation.folders:
            try:
                end_run(folder, code, sentence)
            except OSError as error:  # the disk with the run may be what failed
                console.warn(_of_file(error))
            except CalibError as error:
                console.warn(str(error))
        return (code if outer else _answered(code, invocation)), sentence
    finally:
        for lock in invocation.locks:
            lock.close()
        INVOCATION.reset(token)
        console.QUIET.reset(quiet)


def _quiet(arguments: list[str]) -> tuple[list[str], bool]:
    """The arguments without --quiet, which is accepted anywhere before a `--`, and whether it was given."""
    end = arguments.index("--") if "--" in arguments else len(arguments)
    kept = [word for word in arguments[:end] if word not in ("-q", "--quiet")]
    return [*kept, *arguments[end:]], len(kept) < end


def _run(arguments: list[str], invocation: Invocation) -> tuple[int, str]:
    try:
        result = app(args=arguments or ["--help"], prog_name="calib", standalone_mode=False)
        code = result if isinstance(result, int) else 0
        return code, invocation.outcome or ("done" if code == 0 else f"ended with exit code {code}")
    except CalibError as error:
        sentence = "; besides, ".join([str(error), *getattr(error, "__notes__", ())])
        console.warn(sentence)
        return error.exit_code, sentence
    except typer.TyperException as error:
        sentence = _usage(error, arguments)
        console.warn(sentence)
        return 2, sentence
    except typer.Exit as stop:
        return stop.exit_code, "done" if stop.exit_code == 0 else f"ended with exit code {stop.exit_code}"
    except OSError as error:
        if error.errno not in OF_FILES:
            return _unexpected(error, arguments, invocation)
        console.warn(_of_file(error))
        return 2, _of_file(error)
    except (KeyboardInterrupt, typer.Abort):
        message = "interrupted; nothing more was done"
        if invocation.folders:
            folder = invocation.folders[0]
            message += f"; what was begun is in {folder}"
            message += "" if invocation.is_step else f"; repeat it with `calib runs {folder} --again`"
        console.warn(message)
        return 130, "interrupted by the operator"
    except Exception as error:
        return _unexpected(error, arguments, invocation)


def _answered(code: int, invocation: Invocation) -> int:
    """`code`, or the exit code for an answer that could not be printed; the code of a failure stays."""
    lost = answer.lost()
    if lost is None or code > 1:
        return code
    if isinstance(lost, BrokenPipeError):  # the reader stopped reading, as `| head` does
        return answer.GONE
    stands = f"; the result is in {invocation.folders[0]}" if invocation.folders else ""
    console.warn(f"standard output cannot be written: {lost.strerror or lost}{stands}")
    return 2


def _unexpected(error: Exception, arguments: list[str], invocation: Invocation) -> tuple[int, str]:
    sentence = write_fault(error, arguments, invocation.folders)
    console.warn(sentence)
    return EXIT_CODE, sentence


def _of_file(error: OSError) -> str:
    """The message for a file that the system refuses, with the remedy."""
    return (
        f"{error.filename or 'the disk'}: {error.strerror}; give a path that exists and is writable, on a disk with free space"
    )


def _usage(error: typer.TyperException, arguments: list[str]) -> str:
    """A usage error as one sentence: what is wrong, the nearest valid word, and where the help is."""
    message = error.format_message().rstrip(".")
    context = getattr(error, "ctx", None)
    path = context.command_path if context else "calib"
    if message.startswith("No such command"):
        word = arguments[0] if path == "calib" else message.split("'")[1]
        known = context.command.list_commands(context) if context else list(COMMANDS)
        return f"there is no command {word!r}; {nearest(word, known)}"
    if message.startswith("No such option"):
        word = str(getattr(error, "option_name", ""))
        near = [str(o) for o in getattr(error, "possibilities", None) or ()][:MOST_HINTS]
        hint = f"did you mean {' or '.join(near)}? " if near else ""
        return f"there is no option {word}; {hint}`{path} --help` lists the options"
    return f"{message[0].lower()}{message[1:]}; see `{path} --help`"


if __name__ == "__main__":
    sys.exit(main())
