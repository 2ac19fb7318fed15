"""Replicated shared memory: one robot's copy, and the protocol that keeps all copies equal.

Owns: the logs of rounds, lock arbitration, views, retransmission, failure detection, rejoin and state transfer.
Offers: `Replica`, the protocol as a pure state machine; `Driver`, which does its I/O.
Must not import: `vehicle` or any package above it.

The protocol in ten minutes
===========================

Rounds and entries. Time is divided into rounds of `delta` seconds on a clock that all robots share. In each round a
robot runs at most one event, and then sends one *entry* to all others: the values that the event wrote, if any.
Each robot keeps one log of entries for each robot, itself included (`log`).

Store. S_r is the shared store at the beginning of round r. A robot applies round r when it holds the entries of round r
of all *members*: first one commit for each lock, then the plain writes by ascending pid (`apply`). The result is
S_{r+1}. Robots that have applied the same rounds have equal stores, as the same entries were applied in the same order
(`state_machine`). A robot runs an event in round r only if it has S_r. If an entry is late, the robot skips its event:
that costs time and never changes the meaning of a program.

Locks. An event that contains `atomic` names a lock in its entry. There are no lock messages: all robots see the same
entries of a round and find the same winner, the contender with the least (pid - round - lock) mod N. The events of the
other contenders do not count; their robots find that out when they apply the round.

Applications. A robot may run several programs that share variables. Each of them is an *instance*, with a number in the
fleet, and runs its own event in a round. All events of a robot travel in one entry, with a part for each instance.
Locks, priorities, plain writes and the robot's own variables then go by instance: replace "pid" by "instance" and N by
the number of instances. Messages, progress, views and rejoin know robots only.

Progress and commit. Every message reports how far its sender has applied (`progress`). A round is *committed* once a
majority of all N robots has reported it as applied. A majority decides every later view, and two majorities share
a robot. So no later view leaves out a committed round. Outputs (commands to actuators, lines to streams) wait until
their round is committed: a robot never acts on an event that the fleet forgets (output commit). A round that every
member holds is *settled*, and its entries are dropped. For each robot:

    settled <= committed <= applied <= last own entry

Retransmission. A robot that receives a round message sends back the entries that the message reports as missing. A
robot that misses entries also requests them (NACK), from their author and from one robot that may hold them. Any robot
may send entries of any other robot. A fleet that is late must not spend its time on requests, so late and lost entries
are distinguished (`retransmission`).

    0      1      2          round 7: the entry of robot 1 does not reach robot 2
    |--e7->|      |
    |--e7-------->|
    |      |--e7->X
    |<-e7--|      |
    |<-----------e7
    |      |<----e7          robots 0 and 1 apply round 7, robot 2 does not
    |      |      |
    |<-nack(through 7)|      robot 2 asks robot 1, the author, and one other robot
    |      |<-nack|
    |--e7 of robot 1 ->|     either answer is enough
    |      |      |          robot 2 applies round 7

Failure detector. A member whose entries are missing, and of which nothing new has arrived for `peer_timeout` rounds, is
suspected (`failure_detector`). Suspicion may be wrong; it only starts a view change.

Views. A view says which robots are members from some round on, and each member's *incarnation*: the number of the view
that admitted it last. An entry of another incarnation does not count (fencing). The views are decided one after the
other, each by an instance of Paxos among all N robots (`views`):

    0 (proposer)       1              2
    |--prepare-------->|              |      robots that promise freeze: they apply no round
    |--prepare----------------------->X      (robot 2 has died)
    |<-promise(applied)|              |
    | chooses: members {0,1}, rounds of the old view end with L
    |--accept--------->|              |      robots vote only if they hold all entries up to L
    |<-accepted--------|              |
    |--decided-------->|              |      view 1 {0,1} begins with round L + 1

L is the last round that a majority may have reported as applied, counting the silent robots as if they had. So every
committed round is kept. A robot that has applied more goes back to the store of L (`StateMachine.rewind`): none of its
later rounds can be committed. `schedule` says which view counts in which round while an old view's rounds are still
being applied.

Rejoin. A robot that is no member, or has lost its store, asks to be admitted. The next view gives it a new incarnation.
From then on it sends silent entries, so that no other robot waits for it, and fetches a snapshot of the store, in
fragments, from one member at a time (`rejoin`). A member also rejoins if it lacks entries that no other robot has.

Persistence. Some facts must survive the process, or a restarted robot could contradict itself: its latest view, the
last round that it reported as applied, its promise and its vote (`messages.HardState`), and its own variables after
each event. They are persisted before a message that depends on them is sent.

How the code is used
====================

`Replica` is a pure state machine. It has no clock, network, disk or randomness; time comes in ticks, five in a round.

    replica.step(message)              a message arrived
    replica.tick(tick)                 time has passed
    replica.propose(round, writes)     the robot's event has ended
    replica.apply_rounds()             apply the rounds whose entries have arrived
    ready = replica.ready()            get the work that results:
        persist(ready.persist)           1. to disk
        send(ready.send)                 2. to the network
        act_on(ready.apply)              3. new rounds are applied, and some are committed

`Driver` makes these calls, and only `Driver` persists and sends. So the rule "persist before send" is in one place. A
test can run a fleet of replicas in one process with simulated time, network and disk (tests/model,
tests/runtime/replication/scenarios). `docs/explanation/shared-memory.md` has guarantees, figures and limits,
`docs/reference/wire.md` the wire format.

Reading order: `messages`, `log`, `progress`, `apply`, `state_machine`, `views`, `schedule`, `rejoin`,
`failure_detector`, `retransmission`, `replica`, `driver`.
"""
