"""Lines of a source without remarks, one after the other, and problems with the file and line where they are."""

from cellcal.fake_devices.program_text.expressions import ProgramTextError


class SourceLines:
    """The lines of a file that hold something, with their numbers."""

    def __init__(self, file: str, text: str, remark: str, unread: str = "\n") -> None:
        """Take lines up to where a remark begins; those that begin with ``unread`` count for nothing."""
        self.file = file
        cut = [
            (number, line.partition(remark)[0].strip()) for number, line in enumerate(text.splitlines(), 1)
        ]
        self._lines = [(number, line) for number, line in cut if line and not line.startswith(unread)]
        self._at = 0

    @property
    def has_more(self) -> bool:
        """Whether a line is left."""
        return self._at < len(self._lines)

    def take_line(self) -> tuple[int, str]:
        """Return the next line and its number; a file that has none ends too early."""
        if not self.has_more:
            raise ProgramTextError(f"{self.file} ends too early")
        self._at += 1
        return self._lines[self._at - 1]

    def refusal(
        self, number: int, line: str, why: str = "this simulator does not execute it"
    ) -> ProgramTextError:
        """Return why a line is refused."""
        return locate_problem(self.file, number, f"{line!r}: {why}")

    def locate_refusal(self, number: int, line: str, problem: ProgramTextError) -> ProgramTextError:
        """Return a problem in a line with file and line, which one in a block below has already."""
        return problem if str(problem).startswith(self.file) else self.refusal(number, line, str(problem))


def locate_problem(file: str, number: int, text: str) -> ProgramTextError:
    """Return a problem with the file and line where it is, which one further inside has already."""
    return ProgramTextError(text if text.startswith(file) else f"{file}, line {number}: {text}")
