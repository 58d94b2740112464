"""Bearer tokens: who may do what over TCP.

Read `grants` first (scopes, and what a request is allowed), then `secret` (the form of a token) and
`token_file` (where their digests are kept). Checked by `api.access`, kept by `lecombus token`.
"""
