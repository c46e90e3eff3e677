"""Work objects of one name: a module's own hides another's, which other modules still mean."""

from dataclasses import replace

from cellcal.drivers.abb.program_files.frame_facts import BARRED_DIFFERENT
from cellcal.drivers.programs.file_declarations import ExternalUses, FileDeclarations, MoveFrames, lower_name


def with_local_frames(external_uses: ExternalUses, declarations: FileDeclarations) -> ExternalUses:
    """Return the uses of a file's targets, barred where a work object is named like a local one of the file."""
    local = {name.lower() for name in declarations.local_bases}
    if not local or not external_uses.uses:  # as in most
        return external_uses

    def seen_here(use: MoveFrames, file: str) -> MoveFrames:
        hidden = file != external_uses.file and lower_name(use.frame) in local
        return use._replace(why=use.why or BARRED_DIFFERENT) if hidden else use

    return replace(
        external_uses,
        uses={
            name: [(seen_here(use, file), file) for use, file in some]
            for name, some in external_uses.uses.items()
        },
    )
