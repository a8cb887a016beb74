"""Everything that jiti tells a user as an error.

    JitiError                 a message that says what, where, what was there, what to do
    ├── SourceError           a recording or dataset cannot be read
    ├── CatalogueError        a task file is wrong; names the line
    ├── LabelError            labels cannot be read or written
    │   ├── NewerSchema       written by a later jiti
    │   ├── StaleWrite        someone saved in between; carries what changed
    │   └── SaveFailed        disk full, read-only, gone; nothing was lost
    ├── RobotError            an arm cannot go on; names the servo
    └── UsageError            flags or environment do not fit together

Only the command line and the web handlers catch `JitiError`; a bug keeps its traceback.
"""


class JitiError(Exception):
    """What went wrong, where, and what to do, as one message for a person."""


class SourceError(JitiError):
    """A recording or dataset cannot be read; the message names the file and the place in it."""


class CatalogueError(JitiError):
    """A task catalogue is wrong; the message names the file and the line."""


class LabelError(JitiError):
    """Labels cannot be read or written; the message names the file."""


class NewerSchema(LabelError):
    """The labels were written by a later version of jiti."""


class StaleWrite(LabelError):
    """The write was based on an old version; `changes` are the edits since, oldest first."""

    def __init__(self, message: str, changes: list[dict]) -> None:
        super().__init__(message)
        self.changes = changes


class SaveFailed(LabelError):
    """The disk refused a write; what was saved before is intact and the edit is not acknowledged."""


class RobotError(JitiError):
    """An arm cannot begin or go on; the message names the servo or the part, and what a person is to do."""


class UsageError(JitiError):
    """Flags or environment do not fit together; the message names the flag that fixes it."""
