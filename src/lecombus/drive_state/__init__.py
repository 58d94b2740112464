"""What is known of the line and its drives while it runs.

`drive_runtime` holds one `Drive` for each drive: all that is followed and set of it. `store` keeps
values with time and quality, states and remarks (`judging`: its records and how good they are now,
`readings`: what it returns). `motion` says whether a drive runs and what stops it,
`control_word` what its control word is and whether it is inhibited.

What must not live here: what a family's manual says (`drives`), what outlives the process
(`saved_state`), input and output.
"""
