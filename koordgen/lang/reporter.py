"""Collector of the diagnostics of one program during its checks."""

from __future__ import annotations

from koordgen.lang.diagnostics import Diagnostic, Label, Severity
from koordgen.lang.source import Source, Span


class Reporter:
    """Collector of diagnostics in the order of their reports, with the source that they are about."""

    def __init__(self, source: Source) -> None:
        self.source = source
        self.found: list[Diagnostic] = []

    def report(
        self,
        severity: Severity,
        code: str,
        message: str,
        span: Span,
        help: str = "",
        labels: tuple[Label, ...] = (),
    ) -> None:
        """Add a diagnostic."""
        self.found.append(Diagnostic(code, severity, message, span, labels, help))

    def warn(self, code: str, message: str, span: Span, help: str = "", labels: tuple[Label, ...] = ()) -> None:
        """Add a warning."""
        self.report("warning", code, message, span, help, labels)

    def has_errors(self, since: int = 0) -> bool:
        """Return whether an error was reported, not counting the first `since` diagnostics."""
        return any(diagnostic.severity == "error" for diagnostic in self.found[since:])

    def text(self, span: Span) -> str:
        """Return the source text of a span, up to the end of its first line."""
        line = self.source.line(span.line)
        return line[span.column - 1 : span.end_column - 1] if span.end_line == span.line else line[span.column - 1 :]
