"""Operations: what users ask for, and how it becomes requests to the line.

`facade` is what the API calls: one object made of `reads`, `writes`, `stop_requests`,
`group_writes` and `verb_operations` (whose steps `verb_steps` takes), which share one `context`.
`write_kinds` says what a write is before it is made, `stop_conditions` which stops it depends on.
`facade` logs each change (`actions`). `awaited_requests` submits a request to the line and waits
for its end, `operation_reports` holds the outcomes.
"""
