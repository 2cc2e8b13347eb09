"""Contact sensing: wrenches on fingertips to contacts.

`contact_from_wrench` senses one contact; `Contacts` is the set of them, in the palm frame, that correction
uses.
"""

from handsight.contact.calibration import WrenchCalibration, calibrate_wrench, compensate
from handsight.contact.contact import REASON_NAMES, Contact, ContactBatch, NoContact, Reason
from handsight.contact.contact_table import COLUMNS_HELP, convert
from handsight.contact.contacts import Contacts
from handsight.contact.fingertip_text import FINGERTIP_HELP, parse_fingertip
from handsight.contact.fingertips import Ellipsoid, Fingertip, Sphere, unambiguous_cap
from handsight.contact.sensing import contact_from_wrench, contacts_from_wrenches
from handsight.contact.taxels import SkinTouch, TaxelArray

__all__ = [
    "COLUMNS_HELP",
    "FINGERTIP_HELP",
    "REASON_NAMES",
    "Contact",
    "ContactBatch",
    "Contacts",
    "Ellipsoid",
    "Fingertip",
    "NoContact",
    "Reason",
    "SkinTouch",
    "Sphere",
    "TaxelArray",
    "WrenchCalibration",
    "calibrate_wrench",
    "compensate",
    "contact_from_wrench",
    "contacts_from_wrenches",
    "convert",
    "parse_fingertip",
    "unambiguous_cap",
]
