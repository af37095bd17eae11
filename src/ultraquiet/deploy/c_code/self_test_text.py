"""The words of the self-test's script, scene by scene."""

# One call each: what, how many steps or which channel, and `loud` for measurements beyond the limits. `ramp` is the
# length of the ramp, `some` a part of it, `half` of that, `last` the last channel, `middle` a state. The ramp is walked
# from end to end once in each direction; elsewhere JUMP puts the command `near` steps from its end, for at a high rate
# a ramp has more steps than all else. LAG does so with the count of overruns where their limit is far, and is left out
# where it is not.
START = """
INIT 0
RUN 3                 off: command zero, state at rest
FRAME
DISABLE               of no effect when off
CLEAR
ENABLE
CLEAR                 of no effect without a fault
RUN some
DISABLE
RUN half
ENABLE                resumes where the ramp out stands
RUN ramp+50
CLEAR
RUN 100 loud          limits, both sides
RUN 50
"""
OVERRUNS = """
OUTPUT
FRAME                 an overrun without a hook
UPDATE
UPDATE                a second update must not advance
FRAME
OUTPUT
OUTPUT                a step without its update
FRAME
SPEND 1               overruns stop at their largest value
FRAME
FRAME
UPDATE
DISABLE
RUN ramp+3            out, off and at rest
ENABLE
RUN some
JUMP near_top
RUN near+20
"""
AFTER_BAD = """
ENABLE                refused
CLEAR                 refused while the ramp runs
RUN 2
CLEAR
INIT 1
ENABLE
RUN some+2
"""
FAULTS = """
OUTPUT
FRAME                 an overrun with the hook
UPDATE
OUTPUT
NOT_A_NUMBER          upon an unfinished step: its update must not advance
DISABLE               must not turn a fault into a stop
RUN some
JUMP near
RUN near+2            the end of a fault's ramp
CLEAR
RUN 2
INFINITE last         latched even when off
RUN 2
CLEAR
ENABLE
RUN some
JUMP near_top
RUN near+10
"""
OVERFLOWS = """
RUN 4
OUTPUT
INIT 0                also ends an unfinished step
FRAME
ENABLE
RUN some+2
POKE middle
RUN 2
CLEAR
INIT 0
OUTPUT
FRAME                 the hook is gone
UPDATE
ENABLE
RUN 20 loud           limits during the ramp
NOT_A_NUMBER 0 loud
RUN 5 loud
"""
EXCITATIONS = """
INIT 0
SELECT last_y         the last measurement on tap 0
SELECT last_x         the last state on tap 1
SELECT last_u         the last excitation on tap 2
SELECT last_raw       the last command of the law on tap 3
EXCITE 0
RUN 2                 no command when off
ENABLE
RUN some+2
EXCITE 0
RUN 5
EXCITE 1              beyond its limits
RUN 5
EXCITE 1
OUTPUT
EXCITE 0              between the halves of a step
UPDATE
RUN 3
EXCITE 2              NaN: none at all
RUN 5
EXCITE 0
RUN 30 loud
NOT_A_NUMBER 0        a fault ends it
RUN some
JUMP near
RUN near
CLEAR
ENABLE
RUN some+2
SELECT low_limited    limited 0 on tap 0
SELECT low_applied    applied 0 on tap 1
RUN 2
DISABLE
RUN 1                 where limited and applied differ
SELECT 4              no such tap
SELECT past_y         no such channel
SELECT past_x
SELECT past_u
SELECT 114            no such signal: shows nothing
SELECT 3              nothing on tap 3
RUN 2
INIT 0
"""
STALLS = """
ENABLE
RUN some
JUMP near_top
RUN near+20
OUTPUT
LAG behind            close to a limit that is far
FRAME times           one overrun short of the limit
UPDATE
RUN 3
FRAME
OUTPUT
FRAME                 the score has fallen by one half only
UPDATE
LAG little
FRAME times_twice     frames in time let it fall to zero
OUTPUT
LAG behind
FRAME times
UPDATE
FRAME
OUTPUT
FRAME 2               reaches the limit
UPDATE
RUN 3                 latched, ramping out
ENABLE
JUMP near
RUN near
CLEAR
ENABLE
RUN some+2
OUTPUT
LAG behind
FRAME times
FRAME 1
INIT 0                forgets it
RUN 2
"""
SWAPS = """
LOAD 0                no memory attached
SWAP 1
ATTACH
SWAP 1                nothing loaded
LOAD 1
SWAP 0
LOAD 2
LOAD 3
LOAD 4
SWAP 1
ENABLE
RUN some
JUMP near_top
RUN near+20
LOAD 0
RUN 2                 loaded, not in use
OUTPUT
SWAP 1
LOAD 0                refused while a swap waits
RUN 0
UPDATE                takes effect here
RUN 5
SWAP 1                nothing loaded any more
LOAD 4
RUN 2
LOAD 0
LOAD 1                a refusal also drops what was loaded
SWAP 1
LOAD 0
SWAP 0                by a ramp
RUN half
JUMP near
RUN near+some         out, swapped, on its way in
JUMP near_top
RUN near
LOAD 0
SWAP 0
RUN half
DISABLE               stays out
RUN some
JUMP near
RUN near+2
LOAD 0
SWAP 0                off: at once
RUN 2
ENABLE
RUN some+2
LOAD 0
SWAP 0
RUN 1
NOT_A_NUMBER 0        a fault on the way
RUN half
JUMP near
RUN near+2
CLEAR
RUN 2
ATTACH                built-in coefficients again
ENABLE
RUN some+3
LOAD 0
ATTACH
SWAP 1
LOAD 0
SWAP 0
ATTACH
RUN some+3
INIT 0
SWAP 1
ENABLE
RUN 5
"""
# Both sides of a narrow limit, met by the excitation where the law itself commands nothing.
EXCITED = """
EXCITE 0
RUN 1
EXCITE 0
RUN 1
"""
RETURNS = """
INIT 0
ENABLE
RUN some
JUMP near_top
RUN near+5
DISABLE
JUMP near
RUN near-1
OUTPUT                the last step of the ramp out
ENABLE
UPDATE
RUN 3
DISABLE
OUTPUT                the last step of a ramp of one step
JUMP 1
UPDATE                a step that is still on its way out advances
NOT_A_NUMBER 0
JUMP 1
CLEAR                 refused one step before the end
RUN 2
CLEAR
"""
