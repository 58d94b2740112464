"""Operations: what users ask for, and how it becomes requests to the line.

`facade` is what the API calls: one object made of `reads`, `writes`, `stop_requests`,
`group_writes` and `verb_operations` (whose steps `verb_steps` takes), which share one `context`.
It logs each change (`actions`). `awaited_requests` submits a request to the line and waits for
its end, `operation_reports` holds the outcomes.
"""
