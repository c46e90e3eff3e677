"""What goes wrong when a probe touches a surface."""

from cellcal.procedures.run import ProcedureError


class ContactError(ProcedureError):
    """A touch did not happen as it should; the arm stands."""

    code = "procedure.contact"


class AlreadyInContactError(ContactError):
    """The contact is closed before the approach begins."""

    code = "procedure.already_in_contact"


class NoContactError(ContactError):
    """The whole way was travelled and nothing was touched."""

    code = "procedure.no_contact"


class ContactLostError(ContactError):
    """The contact closed and is open again although the arm has not moved back."""

    code = "procedure.contact_lost"


class BouncingContactError(ContactError):
    """The contact does not settle."""

    code = "procedure.contact_bounces"


class StuckContactError(ContactError):
    """The contact stays closed although the tip has moved away."""

    code = "procedure.contact_stuck"


class OvertravelError(ContactError):
    """The arm pushed the tip farther than the probe allows, or would."""

    code = "procedure.overtravel"
