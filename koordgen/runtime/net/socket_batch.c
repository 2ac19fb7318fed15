/* Batch socket I/O of one robot's process: waits for datagrams, drains its sockets, and sends from the first of them.

   It knows nothing of what a datagram says, allocates nothing, opens and closes nothing, and writes only where its
   caller, socket_batch.py, tells it to. Where there is no compiler, inbox.py does the same in Python; the same
   tests run against both. socket_batch.py defines LARGEST, MOST_AT_ONCE, IN_TURN, MOST_ECHOES, GROUP.

   C99, POSIX, and Linux's recvmmsg. */

#define _GNU_SOURCE
#include <errno.h>
#include <linux/sockios.h>
#include <netinet/in.h>
#include <poll.h>
#include <sched.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <time.h>

enum { MOST_SOCKETS = 2, MOST_ERRORS = 16, ECHO = -1, PLACES = GROUP + 1 };

static const int64_t SECOND = 1000000000; /* ns, as all that follows */
static const int64_t MICROSECOND = 1000;
static const int64_t SPIN = 200000;       /* of looking without sleep: a peer that must wake has answered by then */
static const int LOOKS = 4;               /* before it yields the core */
static const int64_t YIELDED = 5000;      /* a yield that took longer gave the core to somebody who needs it */
static const int64_t FIRST_PACE = 20000;  /* from one of several datagrams to the next, before it is known; */
static const int64_t SHORT_PACE = 5000;   /* the least, */
static const int64_t LONG_PACE = 150000;  /* and the most that is slept for each datagram that is missing */
static const int64_t STEP = 8;            /* a part of the pace by which it changes after a gathering */
static const unsigned long SLACK = 1000;  /* by which a sleep may end later than asked; the system's own is 50000 */
static const int64_t LIGHT = 150000;      /* the end of a long sleep, slept alone: cores wake faster from a short one */
static const int32_t MOST_RESTING = 64;   /* waits that do not spin after a failure */

typedef struct { /* what socket_batch.py reads and writes, field by field */
    int64_t spins, failed;              /* times that it began to spin, and that nothing came of it */
    int64_t pace;                       /* from one of several datagrams to the next, as it was of late */
    int32_t used, arrived;              /* slots, from the first on; those of them that hold no echo */
    int32_t errors, error[MOST_ERRORS]; /* of receiving; socket_batch.py empties it */
    int32_t length[MOST_AT_ONCE];       /* of what is in each slot, or ECHO */
} Shown;

typedef struct {
    Shown shown;
    uint8_t *slots;                       /* MOST_AT_ONCE of LARGEST bytes */
    int32_t looked;                       /* whether the last wait looked what is at the sockets */
    int32_t shares;                       /* whether others of the group are on this computer */
    int32_t sockets;
    struct pollfd socket[MOST_SOCKETS];
    int32_t resting, penalty;             /* waits that will not spin yet; those after the last failure */
    uint32_t next;                        /* in `sent` */
    int32_t length[MOST_ECHOES];          /* of what is in `sent`, or ECHO: it has come back, or there was none */
    uint8_t sent[MOST_ECHOES][LARGEST];   /* to the group, which gives it back to us too */
    struct iovec place[MOST_AT_ONCE];     /* of each slot, as `message`; made once, as few are touched at a time */
    struct mmsghdr message[MOST_AT_ONCE];
    struct sockaddr_in6 address[PLACES];  /* where datagrams go: robots, and behind them the group; IPv4's are shorter */
    socklen_t address_size[PLACES];       /* 0: not known */
} Inbox;

static int64_t now(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_sec * SECOND + t.tv_nsec;
}

static int64_t least(int64_t a, int64_t b) { return a < b ? a : b; }

size_t socket_batch_inbox_size(void) { return sizeof(Inbox); }
size_t socket_batch_shown_size(void) { return sizeof(Shown); }

/* `slots` must live as long as the inbox; `shares`: others of the group are on this computer. Of this thread, sleeps become
   exact. */
void socket_batch_open(Inbox *inbox, uint8_t *slots, const int32_t *sockets, int32_t count, int32_t shares) {
    memset(inbox, 0, sizeof *inbox);
    inbox->slots = slots;
    inbox->shares = shares;
    inbox->sockets = count;
    inbox->shown.pace = FIRST_PACE;
    for (int i = 0; i < count; i++) inbox->socket[i] = (struct pollfd){.fd = sockets[i], .events = POLLIN};
    for (int i = 0; i < MOST_ECHOES; i++) inbox->length[i] = ECHO;
    for (int i = 0; i < MOST_AT_ONCE; i++) {
        inbox->place[i] = (struct iovec){.iov_base = slots + (size_t)i * LARGEST, .iov_len = LARGEST};
        inbox->message[i].msg_hdr.msg_iov = &inbox->place[i];
        inbox->message[i].msg_hdr.msg_iovlen = 1;
    }
    prctl(PR_SET_TIMERSLACK, SLACK, 0, 0, 0);
}

/* From now on its sockets are not looked at: their numbers may become another's. What was not taken is gone. */
void socket_batch_close(Inbox *inbox) { inbox->sockets = 0; }

/* Where a place is, as the system writes addresses. One that it cannot have is none. */
void socket_batch_address(Inbox *inbox, int32_t place, const uint8_t *address, int32_t size) {
    if (place < 0 || place >= PLACES) return;
    inbox->address_size[place] = 0;
    if ((size_t)size > sizeof inbox->address[place]) return; /* as is one of less than no bytes */
    memcpy(&inbox->address[place], address, (size_t)size);
    inbox->address_size[place] = (socklen_t)size;
}

/* This goes to the group. One that is too long for it comes back cut, and so unlike what was sent. */
static void remember(Inbox *inbox, const uint8_t *datagram, int32_t length) {
    uint32_t place = inbox->next++ % MOST_ECHOES;
    inbox->length[place] = length;
    memcpy(inbox->sent[place], datagram, (size_t)(length < LARGEST ? length : LARGEST));
}

/* Send to a place, or not at all: it never blocks. Returns 0 or errno. What goes to the group is remembered first, and
   also when it fails: the system may have given it back by then. Who has sent it lets those go first that share the core
   and have not: all wait for the last of them. */
int32_t socket_batch_send(Inbox *inbox, int32_t place, const uint8_t *datagram, int32_t length) {
    if (!inbox->sockets) return EBADF;
    if (place < 0 || place >= PLACES || !inbox->address_size[place]) return EDESTADDRREQ;
    if (place == GROUP) remember(inbox, datagram, length);
    const struct sockaddr *to = (const struct sockaddr *)&inbox->address[place];
    ssize_t sent;
    do sent = sendto(inbox->socket[0].fd, datagram, (size_t)length, MSG_DONTWAIT | MSG_NOSIGNAL, to,
                     inbox->address_size[place]);
    while (sent < 0 && errno == EINTR);
    if (sent < 0) return errno;
    if (place == GROUP && inbox->shares) sched_yield();
    return 0;
}

/* Whether it is one of those that were sent; each comes back once. */
static int is_echo(Inbox *inbox, const uint8_t *datagram, int32_t length) {
    for (int i = 0; i < MOST_ECHOES; i++) {
        if (inbox->length[i] == length && !memcmp(inbox->sent[i], datagram, (size_t)length)) {
            inbox->length[i] = ECHO;
            return 1;
        }
    }
    return 0;
}

/* Up to IN_TURN datagrams from one socket; whether there may be more. */
static int take(Inbox *inbox, int number) {
    int room = (int)least(IN_TURN, MOST_AT_ONCE - inbox->shown.used);
    if (!room || inbox->shown.errors == MOST_ERRORS) return 0;
    int count = recvmmsg(inbox->socket[number].fd, inbox->message + inbox->shown.used, (unsigned)room, MSG_DONTWAIT, NULL);
    if (count < 0) {
        if (errno == EAGAIN || errno == EWOULDBLOCK || errno == EINTR) return 0;
        inbox->shown.error[inbox->shown.errors++] = errno; /* an earlier send's, nothing about what waits */
        return 1;
    }
    for (int i = 0; i < count; i++, inbox->shown.used++) {
        int32_t length = (int32_t)inbox->message[inbox->shown.used].msg_len;
        int echo = is_echo(inbox, inbox->slots + (size_t)inbox->shown.used * LARGEST, length);
        inbox->shown.length[inbox->shown.used] = echo ? ECHO : length;
        inbox->shown.arrived += !echo;
    }
    return count == room;
}

/* What waits at the sockets, by turns, as far as there is room. */
static void drain(Inbox *inbox) {
    inbox->looked = 1;
    int more = (1 << inbox->sockets) - 1; /* a bit for each socket that may have more */
    while (more)
        for (int i = 0; i < inbox->sockets; i++)
            if (more >> i & 1 && !take(inbox, i)) more &= ~(1 << i);
}

/* Whether there is reason to end a wait, whatever it waits for. */
static int full(const Inbox *inbox) { return inbox->shown.errors || inbox->shown.used == MOST_AT_ONCE; }

/* Sleep, at most so long; where `wakes`, until something is at a socket. Whether something is; -1: a signal came, which
   Python must see. */
static int rest(Inbox *inbox, int64_t duration, int wakes) {
    struct timespec t = {.tv_sec = (time_t)(duration / SECOND), .tv_nsec = (long)(duration % SECOND)};
    int ready = ppoll(inbox->socket, wakes ? (nfds_t)inbox->sockets : 0, &t, NULL);
    return ready < 0 ? -(errno == EINTR) : ready;
}

/* Look for what is still missing without sleeping, for to wake a core takes longer than most datagrams. Whether it has
   come. Each time that it does not, twice as many further waits do not try; and who yields the core and does not get it
   back at once lets it go: so it costs little where it is of no use. */
static int spin(Inbox *inbox, int32_t expected, int64_t end) {
    if (inbox->resting > 0) {
        inbox->resting--;
        return 0;
    }
    inbox->shown.spins++;
    int64_t at = now(), yielded = 0;
    end = least(end, at + SPIN);
    for (int look = 1; at < end && yielded <= YIELDED; look++, at += yielded) {
        drain(inbox);
        if (inbox->shown.arrived >= expected || full(inbox)) {
            inbox->penalty = 0;
            return 1;
        }
        at = now();
        yielded = 0;
        if (look % LOOKS) continue;
        sched_yield();
        yielded = now() - at;
    }
    inbox->shown.failed++;
    inbox->penalty = inbox->penalty ? (int32_t)least(2 * inbox->penalty, MOST_RESTING) : 1;
    inbox->resting = inbox->penalty;
    return 0;
}

/* Until so many have arrived, or the end; 0: a signal came. What comes while the end passes is left for the next look:
   the caller has something to do now, and others may wait for it. */
static int wait_for(Inbox *inbox, int32_t expected, int64_t end) {
    for (int tried = 0; inbox->shown.arrived < expected && !full(inbox); tried = 1) {
        if (!tried && now() < end && spin(inbox, expected, end)) break;
        int64_t left = end - now();
        if (left <= 0) break;
        int ready = rest(inbox, left > 2 * LIGHT ? left - LIGHT : left, 1);
        if (ready < 0) return 0;
        if (ready && now() < end) drain(inbox);
    }
    return 1;
}

/* When the last one that was taken came, by the system's word; 0: it does not say. */
static int64_t last_came(const Inbox *inbox) {
    struct timespec clock, came;
    int64_t age = INT64_MAX;
    clock_gettime(CLOCK_REALTIME, &clock); /* the one that the system stamps with */
    for (int i = 0; i < inbox->sockets; i++)
        if (!ioctl(inbox->socket[i].fd, SIOCGSTAMPNS, &came))
            age = least(age, (clock.tv_sec - came.tv_sec) * SECOND + clock.tv_nsec - came.tv_nsec);
    return age < INT64_MAX ? now() - age : 0;
}

/* So many came since `begin`. The pace stays where half of the gatherings are slower: what goes wrong now and then counts
   for little. */
static void learn(Inbox *inbox, int32_t count, int64_t begin) {
    int64_t came = last_came(inbox), pace = inbox->shown.pace;
    if (!came) return;
    pace += ((came - begin) / count > pace ? pace : -pace) / STEP;
    inbox->shown.pace = pace < SHORT_PACE ? SHORT_PACE : least(pace, LONG_PACE);
}

/* Until so many have arrived, or the end; 0: a signal came. To look when all should be there is cheaper than to wake
   for each; the last one, which completes what is waited for, is worth to be seen at once. */
static int gather(Inbox *inbox, int32_t expected, int64_t begin, int64_t end) {
    int32_t before = inbox->shown.arrived, missing;
    int64_t left;
    while ((missing = expected - inbox->shown.arrived) > 1 && !full(inbox) && (left = end - now()) > 0) {
        if (rest(inbox, least(inbox->shown.pace * missing, left), 0) < 0) return 0;
        drain(inbox);
    }
    if (inbox->shown.arrived - before > 1) learn(inbox, inbox->shown.arrived - before, begin);
    return wait_for(inbox, expected, end);
}

/* The slots are free again. */
static void empty(Shown *shown) { shown->used = shown->arrived = 0; }

/* So many are to be taken; -1: there are errors, too. */
static int32_t found(const Inbox *inbox) { return inbox->shown.errors ? -1 : inbox->shown.arrived; }

/* See Transport.wait; both durations are in microseconds. What was found before is kept, and counts, if it was not taken.
   Ends early when a signal comes. Returns what it has found. */
int32_t socket_batch_wait(Inbox *inbox, int32_t expected, int32_t taken, int32_t duration, int32_t patience) {
    Shown *shown = &inbox->shown;
    int64_t begin = now(), end = begin + MICROSECOND * duration, until = least(end, begin + MICROSECOND * patience);
    int keep = !taken && shown->used;
    int look = keep || expected > 1 || end == begin || !inbox->looked; /* of two waits at least one looks */
    if (!keep) empty(shown);
    inbox->looked = 0;
    if (look) drain(inbox);
    if (expected <= 1 || gather(inbox, expected, begin, until)) wait_for(inbox, 1, end);
    return found(inbox);
}

/* Take what waits, without waiting. Returns what it has found. */
int32_t socket_batch_receive(Inbox *inbox) {
    empty(&inbox->shown);
    drain(inbox);
    return found(inbox);
}
