"""The commands by what a person wants to do, with the sentence of each; read without loading any of them."""

from typing import NamedTuple


class CommandEntry(NamedTuple):
    """A command: its name, the module and function that carry it out, and the first sentence of its own help."""

    name: str
    target: str
    summary: str


COMMAND_GROUPS: tuple[tuple[str, tuple[CommandEntry, ...]], ...] = (
    (
        "Try it without a robot",
        (
            CommandEntry(
                "demo",
                "demo:demo",
                "Try cellcal on a fake cell: lose its encoders, get its zero back, over real sockets.",
            ),
            CommandEntry(
                "fakes",
                "cells:fakes",
                "Play the devices that a cell file names, on its (loopback) addresses, until interrupted.",
            ),
            CommandEntry(
                "simulate-cell",
                "simulate_cell:simulate_cell",
                "Make a simulated cell like the real one, from tag points of both.",
            ),
        ),
    ),
    (
        "A cell and its procedures",
        (
            CommandEntry(
                "check",
                "cells:check",
                "Validate a cell file, reach every device it names, and compare what each says of itself.",
            ),
            CommandEntry(
                "serve", "serve:serve", "Serve a cell to browsers: the wizard, its live values, its history."
            ),
            CommandEntry(
                "watch",
                "watch:watch",
                "Follow the encoders of a cell until interrupted; on a loss offer the recovery, or run it where "
                "allowed.",
            ),
            CommandEntry(
                "mastering",
                "mastering:mastering",
                "Take, watch, show, print, export and import the mastering record of a robot.",
            ),
            CommandEntry(
                "procedures",
                "procedure_preview:procedures",
                "List the procedures, and for a cell what it lacks for each; or the settings of one. No device is "
                "touched.",
            ),
            CommandEntry(
                "run",
                "runs:run",
                "Run a procedure on a cell, with progress; questions are asked in the terminal.",
            ),
            CommandEntry(
                "resume",
                "runs:resume",
                "Go on with an interrupted run: what was found is kept, only what is missing is done.",
            ),
            CommandEntry("runs", "runs:runs", "List the runs that a cell's journal holds."),
            CommandEntry(
                "show",
                "runs:show",
                "Show one run: its steps, findings and result; and whether the journal is unchanged.",
            ),
            CommandEntry(
                "alignments",
                "alignments:alignments",
                "Show and export where fixtures stand in the robots' bases.",
            ),
        ),
    ),
    (
        "Certificates and data",
        (
            CommandEntry(
                "certificate",
                "certificate:certificate",
                "Write the signed certificate of a finished run, or show the key.",
            ),
            CommandEntry(
                "verify",
                "certificate:verify",
                "Check offline that a certificate or an exported record is what was signed, to the last byte.",
            ),
            CommandEntry(
                "export",
                "export:export",
                "Tables for spreadsheets and other programs: CSV or XLSX, SI units, every digit kept.",
            ),
            CommandEntry(
                "backup",
                "backup:backup",
                "Keep a cell's data in one file, also while it runs: journal, certificates, people, records, "
                "parameter sets.",
            ),
            CommandEntry(
                "restore",
                "backup:restore",
                "Put a backup back where nothing is, after every byte, the journal's chain and every certificate "
                "were proved.",
            ),
        ),
    ),
    (
        "Robots and measurements",
        (
            CommandEntry(
                "identify",
                "identify:identify",
                "Identify a robot from measurements, and say how far the result can be believed.",
            ),
            CommandEntry(
                "poses",
                "poses:poses",
                "Plan measurement poses, and predict parameter and tool point uncertainty before measuring.",
            ),
            CommandEntry(
                "parameters",
                "parameters:parameters",
                "Keep, compare, restore and exchange identified robot parameters.",
            ),
            CommandEntry(
                "models",
                "models:models",
                "Find robots that ship, by words in any spelling, or show one with its source and what to doubt.",
            ),
            CommandEntry(
                "ur-model",
                "ur_model:ur_model",
                "Write the model file of an arm from what its Universal Robots controller tells; nothing is sent "
                "to it.",
            ),
            CommandEntry(
                "bench",
                "bench:bench",
                "Measure speed and accuracy against pybotics, figaroh, roboticstoolbox and a pinocchio loop.",
            ),
        ),
    ),
    (
        "Robot programs",
        (
            CommandEntry(
                "program",
                "program:program",
                "Inspect robot programs; move, clone and compensate them; see which cell runs which version; "
                "copy, compare and replace those of controllers.",
            ),
        ),
    ),
    (
        "People and the site",
        (
            CommandEntry(
                "people", "people:people", "People, roles, PINs and enrolled devices of a cell's service."
            ),
            CommandEntry(
                "site",
                "site:site",
                "Let a site see its cells from afar. Nothing that is said there reaches a robot.",
            ),
            CommandEntry(
                "monitor",
                "monitor:monitor",
                "Show the cells of a site: which are there, alarms, runs, drift, last certificate, what is due.",
            ),
            CommandEntry(
                "webhooks",
                "webhooks:webhooks",
                "Send a cell's alarms to another program; `cellcal serve` does it by itself.",
            ),
        ),
    ),
)
