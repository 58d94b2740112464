"""What the answers look like, for the OpenAPI document only.

The answers themselves are written straight from the store (`exact`), because walking every value
through a model costs more than everything else about a stored read. So that the two cannot drift
apart, the tests hold real answers against these models.

What must not live here: anything a request passes through.
"""

from __future__ import annotations

from lecombus.api.documents.custody import (
    ForgottenTimesDocument,
    IdentityDocument,
    WearDocument,
)
from lecombus.api.documents.described import CodeDocument, DescribedDocument
from lecombus.api.documents.findings import WhyDocument
from lecombus.api.documents.known import (
    DriveDocument,
    DrivesDocument,
    GroupsDocument,
    HeardDocument,
    LineDocument,
    ReadingDocument,
    RestoreDocument,
)
from lecombus.api.documents.outcomes import GroupOutcomeDocument, OutcomeDocument, VerbDocument
from lecombus.api.documents.service import (
    PlanDocument,
    ProblemDocument,
    StatusDocument,
    problem_responses,
)

__all__ = [
    "CodeDocument",
    "DescribedDocument",
    "DriveDocument",
    "DrivesDocument",
    "ForgottenTimesDocument",
    "GroupOutcomeDocument",
    "GroupsDocument",
    "HeardDocument",
    "IdentityDocument",
    "LineDocument",
    "OutcomeDocument",
    "PlanDocument",
    "ProblemDocument",
    "ReadingDocument",
    "RestoreDocument",
    "StatusDocument",
    "VerbDocument",
    "WearDocument",
    "WhyDocument",
    "problem_responses",
]
