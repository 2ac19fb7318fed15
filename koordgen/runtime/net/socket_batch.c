/* Batch socket I/O of one robot's process: waits for datagrams, drains its sockets, and sends from the first of them.

   This code does not read the content of datagrams, allocates no memory, opens and closes no sockets, and writes only
   into memory that its caller, socket_batch.py, owns. Without a compiler, inbox.py does the same in Python; the same
   tests run against both. socket_batch.py defines LARGEST, MOST_AT_ONCE, IN_TURN, MOST_ECHOES, GROUP,
   PLACES.

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

enum { MOST_SOCKETS = 2, MOST_ERRORS = 16, ECHO = -1 };

/* All times are in nanoseconds. */
static const int64_t SECOND = 1000000000;
static const int64_t MICROSECOND = 1000;
static const int64_t SPIN = 200000;       /* longest spinning, enough for a peer to wake and to answer */
static const int LOOKS = 4;               /* checks of the sockets between two yields of the core while spinning */
static const int64_t YIELDED = 5000;      /* after a longer yield spinning ends: another thread needs the core */
static const int64_t FIRST_PACE = 20000;  /* first estimate of the time between two datagrams of a batch */
static const int64_t SHORT_PACE = 5000;   /* least estimate of that time */
static const int64_t LONG_PACE = 150000;  /* greatest estimate of that time */
static const int64_t STEP = 8;            /* a gathering changes the estimate by 1/STEP of it */
static const unsigned long SLACK = 1000;  /* timer slack of this thread; the system's default is 50000 */
static const int64_t LIGHT = 150000;      /* last part of a long sleep: cores wake faster from a short one */
static const int32_t MOST_RESTING = 64;   /* largest number of waits without spinning after spinning has failed */

typedef struct { /* fields that socket_batch.py reads and writes */
    int64_t spins, failed;              /* number of times that spinning began, and that it found nothing */
    int64_t pace;                       /* estimated time between two datagrams of a batch */
    int32_t used, arrived;              /* number of used slots; number of these without an echo */
    int32_t errors, error[MOST_ERRORS]; /* number and errno of failures; socket_batch.py resets them */
    int32_t length[MOST_AT_ONCE];       /* length of the datagram in each slot; ECHO: it is an own one */
} Shown;

typedef struct {
    Shown shown;
    uint8_t *slots;                       /* MOST_AT_ONCE slots of LARGEST bytes for received datagrams */
    int32_t looked;                       /* whether the last wait read the sockets */
    int32_t shares;                       /* whether other robots of the group run on this computer */
    int32_t sockets;                      /* number of sockets */
    struct pollfd socket[MOST_SOCKETS];
    int32_t resting, penalty;             /* number of next waits without spinning; its value after the last failure */
    uint32_t next;                        /* number of the next datagram in `sent` */
    int32_t length[MOST_ECHOES];          /* length of each datagram in `sent`; ECHO: it came back, or there is none */
    uint8_t sent[MOST_ECHOES][LARGEST];   /* own datagrams to the group, of which the system returns a copy */
    struct iovec place[MOST_AT_ONCE];     /* memory of each slot, in the form that `message` needs */
    struct mmsghdr message[MOST_AT_ONCE]; /* arguments of recvmmsg, filled in once */
    struct sockaddr_in6 address[PLACES];  /* addresses of the robots by pid, then of the group */
    socklen_t address_size[PLACES];       /* bytes of each address; 0: unknown */
} Inbox;

static int64_t now(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_sec * SECOND + t.tv_nsec;
}

static int64_t least(int64_t a, int64_t b) { return a < b ? a : b; }

size_t socket_batch_inbox_size(void) { return sizeof(Inbox); }
size_t socket_batch_shown_size(void) { return sizeof(Shown); }

/* Initialise an inbox. `slots` must live as long as the inbox. `shares`: other robots of the group run on this
   computer. Also sets the timer slack of this thread to SLACK, so that sleeps end on time. */
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

/* Stop using the sockets, because the system may reuse their descriptors. Datagrams not yet received are lost. */
void socket_batch_close(Inbox *inbox) { inbox->sockets = 0; }

/* Set the address of a place, as a struct sockaddr. An address of an invalid size makes the place unknown. */
void socket_batch_address(Inbox *inbox, int32_t place, const uint8_t *address, int32_t size) {
    if (place < 0 || place >= PLACES) return;
    inbox->address_size[place] = 0;
    if ((size_t)size > sizeof inbox->address[place]) return; /* also for a negative size, which becomes large */
    memcpy(&inbox->address[place], address, (size_t)size);
    inbox->address_size[place] = (socklen_t)size;
}

/* Remember a datagram to the group, to recognise its copy. The copy of one longer than LARGEST is not recognised. */
static void remember(Inbox *inbox, const uint8_t *datagram, int32_t length) {
    uint32_t place = inbox->next++ % MOST_ECHOES;
    inbox->length[place] = length;
    memcpy(inbox->sent[place], datagram, (size_t)(length < LARGEST ? length : LARGEST));
}

/* Send to a place without blocking. Returns 0 or errno. A datagram to the group is remembered before it is sent, and
   also if sending fails, because the system may have returned its copy by then. After a send to the group the core
   is yielded if other robots share the computer, because all robots wait for the last one that sends. */
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

/* Return whether a datagram is the copy of an own one. Each copy comes back once. */
static int is_echo(Inbox *inbox, const uint8_t *datagram, int32_t length) {
    for (int i = 0; i < MOST_ECHOES; i++) {
        if (inbox->length[i] == length && !memcmp(inbox->sent[i], datagram, (size_t)length)) {
            inbox->length[i] = ECHO;
            return 1;
        }
    }
    return 0;
}

/* Receive up to IN_TURN datagrams from one socket. Returns whether there may be more. */
static int take(Inbox *inbox, int number) {
    int room = (int)least(IN_TURN, MOST_AT_ONCE - inbox->shown.used);
    if (!room || inbox->shown.errors == MOST_ERRORS) return 0;
    int count = recvmmsg(inbox->socket[number].fd, inbox->message + inbox->shown.used, (unsigned)room, MSG_DONTWAIT, NULL);
    if (count < 0) {
        if (errno == EAGAIN || errno == EWOULDBLOCK || errno == EINTR) return 0;
        inbox->shown.error[inbox->shown.errors++] = errno; /* an error of an earlier send; datagrams may wait */
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

/* Receive all waiting datagrams from the sockets in turn, as long as there are free slots. */
static void drain(Inbox *inbox) {
    inbox->looked = 1;
    int more = (1 << inbox->sockets) - 1; /* a bit for each socket that may have more */
    while (more)
        for (int i = 0; i < inbox->sockets; i++)
            if (more >> i & 1 && !take(inbox, i)) more &= ~(1 << i);
}

/* Return whether a wait must end in any case: after an error, or without free slots. */
static int full(const Inbox *inbox) { return inbox->shown.errors || inbox->shown.used == MOST_AT_ONCE; }

/* Sleep for at most `duration`; if `wakes`, only until a datagram arrives. Returns whether one has arrived; -1: a
   signal arrived, which Python must handle. */
static int rest(Inbox *inbox, int64_t duration, int wakes) {
    struct timespec t = {.tv_sec = (time_t)(duration / SECOND), .tv_nsec = (long)(duration % SECOND)};
    int ready = ppoll(inbox->socket, wakes ? (nfds_t)inbox->sockets : 0, &t, NULL);
    return ready < 0 ? -(errno == EINTR) : ready;
}

/* Poll the sockets without sleeping, because waking a core takes longer than most datagrams need. Returns whether
   the expected datagrams have arrived. To limit the cost where spinning does not help, each failure doubles the
   number of further waits that do not spin, and spinning ends when a yield does not return at once. */
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

/* Wait until `expected` datagrams have arrived, or until `end`. Returns 0 if a signal arrived, else 1. A datagram
   that arrives at `end` is left for the next call, because the caller has urgent work then. */
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

/* Return the time at which the last received datagram arrived, by the system's time stamp; 0 without a time stamp. */
static int64_t last_came(const Inbox *inbox) {
    struct timespec clock, came;
    int64_t age = INT64_MAX;
    clock_gettime(CLOCK_REALTIME, &clock); /* the clock of the system's time stamps */
    for (int i = 0; i < inbox->sockets; i++)
        if (!ioctl(inbox->socket[i].fd, SIOCGSTAMPNS, &came))
            age = least(age, (clock.tv_sec - came.tv_sec) * SECOND + clock.tv_nsec - came.tv_nsec);
    return age < INT64_MAX ? now() - age : 0;
}

/* Update the estimated pace after `count` datagrams have arrived since `begin`. The estimate approaches the median
   of all gatherings, because it changes by a fixed share up or down; so rare outliers have little effect. */
static void learn(Inbox *inbox, int32_t count, int64_t begin) {
    int64_t came = last_came(inbox), pace = inbox->shown.pace;
    if (!came) return;
    pace += ((came - begin) / count > pace ? pace : -pace) / STEP;
    inbox->shown.pace = pace < SHORT_PACE ? SHORT_PACE : least(pace, LONG_PACE);
}

/* Wait until `expected` datagrams have arrived, or until `end`. Returns 0 if a signal arrived, else 1. Sleeping
   until all should have arrived costs less than waking for each one. Only the wait for the last one ends at its
   arrival. */
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

/* Mark all slots as free. */
static void empty(Shown *shown) { shown->used = shown->arrived = 0; }

/* Return the number of received datagrams; -1 if there are errors, too. */
static int32_t found(const Inbox *inbox) { return inbox->shown.errors ? -1 : inbox->shown.arrived; }

/* Wait as Transport.wait; both durations are in microseconds. `taken`: Python has read the datagrams found before;
   otherwise they are kept, and count. Ends early when a signal arrives. Returns the result of `found`. */
int32_t socket_batch_wait(Inbox *inbox, int32_t expected, int32_t taken, int32_t duration, int32_t patience) {
    Shown *shown = &inbox->shown;
    int64_t begin = now(), end = begin + MICROSECOND * duration, until = least(end, begin + MICROSECOND * patience);
    int keep = !taken && shown->used;
    int look = keep || expected > 1 || end == begin || !inbox->looked; /* of two successive waits, at least one reads */
    if (!keep) empty(shown);
    inbox->looked = 0;
    if (look) drain(inbox);
    if (expected <= 1 || gather(inbox, expected, begin, until)) wait_for(inbox, 1, end);
    return found(inbox);
}

/* Receive the datagrams that have arrived, without waiting. Returns the result of `found`. */
int32_t socket_batch_receive(Inbox *inbox) {
    empty(&inbox->shown);
    drain(inbox);
    return found(inbox);
}
