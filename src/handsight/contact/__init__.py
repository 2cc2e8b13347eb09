"""Contact sensing: from wrenches on fingertips, and from tactile arrays, to contacts.

`contact_from_wrench` senses one contact; `Contacts` is the set of contacts in the palm frame that correction uses.
"""

from handsight.contact.calibration import WrenchCalibration, calibrate_wrench, compensate
from handsight.contact.contact import REASON_NAMES, Contact, ContactBatch, NoContact, Reason
from handsight.contact.contacts import Contacts
from handsight.contact.fingertips import (
    FINGERTIP_HELP,
    Ellipsoid,
    Fingertip,
    Sphere,
    parse_fingertip,
    unambiguous_cap,
)
from handsight.contact.sensing import contact_from_wrench, contacts_from_wrenches
from handsight.contact.tables import COLUMNS_HELP, convert
from handsight.contact.taxels import SkinTouch, TactileSurface

__all__ = [
    "COLUMNS_HELP", "FINGERTIP_HELP", "REASON_NAMES", "Contact", "ContactBatch", "Contacts", "Ellipsoid",
    "Fingertip", "NoContact", "Reason", "SkinTouch", "Sphere", "TactileSurface", "WrenchCalibration",
    "calibrate_wrench", "compensate", "contact_from_wrench", "contacts_from_wrenches",
    "convert", "parse_fingertip", "unambiguous_cap",
]  # fmt: skip
