/* The courier of one robot's process: waits for datagrams, drains sockets, checks MACs.

   It knows nothing of what a datagram says, allocates nothing, opens and closes nothing, and writes only where its
   caller, courier.py, tells it to. Where there is no compiler, inbox.py and seal.py do the same in Python; tests
   compare the two. The compiler is told by courier.py: LARGEST, MOST_AT_ONCE, IN_TURN, MOST_ECHOES, MAC_SIZE.

   C99, POSIX and Linux's recvmmsg. Any byte order, no unaligned access. */

#define _GNU_SOURCE
#include <errno.h>
#include <poll.h>
#include <sched.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <time.h>

/* ---- MACs: BLAKE2s (RFC 7693) with a key, a personalization, and a digest of MAC_SIZE bytes ---- */

enum { BLOCK = 64, KEY_MOST = 32, PURPOSE = 8 };

typedef struct {
    uint32_t begun[8];    /* the state before the first block */
    uint32_t keyed[8];    /* and after the key's block, which every message of at least one byte shares */
    uint8_t block[BLOCK]; /* the key's block */
    int32_t length;       /* of the key; 0: none, and no block */
} Key;

static const uint32_t IV[8] = {0x6a09e667, 0xbb67ae85, 0x3c6ef372, 0xa54ff53a,
                               0x510e527f, 0x9b05688c, 0x1f83d9ab, 0x5be0cd19};

static const uint8_t SIGMA[10][16] = {
    {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15}, {14, 10, 4, 8, 9, 15, 13, 6, 1, 12, 0, 2, 11, 7, 5, 3},
    {11, 8, 12, 0, 5, 2, 15, 13, 10, 14, 3, 6, 7, 1, 9, 4}, {7, 9, 3, 1, 13, 12, 11, 14, 2, 6, 5, 10, 4, 0, 15, 8},
    {9, 0, 5, 7, 2, 4, 10, 15, 14, 1, 11, 12, 6, 8, 3, 13}, {2, 12, 6, 10, 0, 11, 8, 3, 4, 13, 7, 5, 15, 14, 1, 9},
    {12, 5, 1, 15, 14, 13, 4, 10, 0, 7, 6, 3, 9, 2, 8, 11}, {13, 11, 7, 14, 12, 1, 3, 9, 5, 0, 15, 4, 8, 6, 2, 10},
    {6, 15, 14, 9, 11, 3, 0, 8, 12, 2, 13, 7, 1, 4, 10, 5}, {10, 2, 8, 4, 7, 6, 1, 5, 15, 11, 9, 14, 3, 12, 13, 0},
};

static uint32_t load(const uint8_t *at) {
    return (uint32_t)at[0] | (uint32_t)at[1] << 8 | (uint32_t)at[2] << 16 | (uint32_t)at[3] << 24;
}

static uint32_t rotated(uint32_t word, int right) { return word >> right | word << (32 - right); }

/* Macros, and ten rounds written out: only so does a compiler keep the state in registers, which is 2.5 times as fast. */
#define MIX(r, i, a, b, c, d)                          \
    do {                                               \
        a += b + m[SIGMA[r][2 * i]];                   \
        d = rotated(d ^ a, 16);                        \
        c += d;                                        \
        b = rotated(b ^ c, 12);                        \
        a += b + m[SIGMA[r][2 * i + 1]];               \
        d = rotated(d ^ a, 8);                         \
        c += d;                                        \
        b = rotated(b ^ c, 7);                         \
    } while (0)
#define ROUND(r)                                       \
    do {                                               \
        MIX(r, 0, v0, v4, v8, v12);                    \
        MIX(r, 1, v1, v5, v9, v13);                    \
        MIX(r, 2, v2, v6, v10, v14);                   \
        MIX(r, 3, v3, v7, v11, v15);                   \
        MIX(r, 4, v0, v5, v10, v15);                   \
        MIX(r, 5, v1, v6, v11, v12);                   \
        MIX(r, 6, v2, v7, v8, v13);                    \
        MIX(r, 7, v3, v4, v9, v14);                    \
    } while (0)

/* One block; `bytes`: so many with this one. */
static void compress(uint32_t h[8], const uint8_t block[BLOCK], uint64_t bytes, int last) {
    uint32_t m[16];
    for (int i = 0; i < 16; i++) m[i] = load(block + 4 * i);
    uint32_t v0 = h[0], v1 = h[1], v2 = h[2], v3 = h[3], v4 = h[4], v5 = h[5], v6 = h[6], v7 = h[7];
    uint32_t v8 = IV[0], v9 = IV[1], v10 = IV[2], v11 = IV[3], v12 = IV[4] ^ (uint32_t)bytes;
    uint32_t v13 = IV[5] ^ (uint32_t)(bytes >> 32), v14 = last ? ~IV[6] : IV[6], v15 = IV[7];
    ROUND(0); ROUND(1); ROUND(2); ROUND(3); ROUND(4); ROUND(5); ROUND(6); ROUND(7); ROUND(8); ROUND(9);
    h[0] ^= v0 ^ v8, h[1] ^= v1 ^ v9, h[2] ^= v2 ^ v10, h[3] ^= v3 ^ v11;
    h[4] ^= v4 ^ v12, h[5] ^= v5 ^ v13, h[6] ^= v6 ^ v14, h[7] ^= v7 ^ v15;
}

size_t courier_key_size(void) { return sizeof(Key); }

/* `secret` has at most KEY_MOST bytes, `purpose` PURPOSE, with zeros at its end. */
void courier_key(Key *key, const uint8_t *secret, int32_t length, const uint8_t *purpose) {
    uint8_t parameters[32] = {MAC_SIZE, (uint8_t)length, 1, 1};
    memcpy(parameters + 24, purpose, PURPOSE);
    memset(key, 0, sizeof *key);
    key->length = length;
    memcpy(key->block, secret, (size_t)length);
    for (int i = 0; i < 8; i++) key->begun[i] = IV[i] ^ load(parameters + 4 * i);
    memcpy(key->keyed, key->begun, sizeof key->keyed);
    if (length) compress(key->keyed, key->block, BLOCK, 0);
}

void courier_mac(const Key *key, const uint8_t *data, size_t length, uint8_t mac[MAC_SIZE]) {
    uint8_t last[BLOCK] = {0};
    uint32_t h[8];
    uint64_t before = key->length ? BLOCK : 0, bytes = before + length;
    if (!length && key->length) { /* the key's block is the last one */
        memcpy(h, key->begun, sizeof h);
        compress(h, key->block, BLOCK, 1);
    } else {
        memcpy(h, key->keyed, sizeof h);
        for (; length > BLOCK; data += BLOCK, length -= BLOCK) compress(h, data, before += BLOCK, 0);
        if (length) memcpy(last, data, length);
        compress(h, last, bytes, 1);
    }
    for (int i = 0; i < MAC_SIZE; i++) mac[i] = (uint8_t)(h[i / 4] >> 8 * (i % 4));
}

/* Of datagrams that lie one behind the other: genuine[i] becomes 1 where the i-th is more than its MAC, and that is
   right, else 0. In a time that does not depend on how much of a MAC is right. */
void courier_genuine(const Key *key, const uint8_t *datagrams, const uint32_t *lengths, int32_t count,
                     uint8_t *genuine) {
    uint8_t mac[MAC_SIZE];
    for (int32_t i = 0; i < count; datagrams += lengths[i], i++) {
        uint8_t differing = 0;
        genuine[i] = 0;
        if (lengths[i] <= MAC_SIZE) continue;
        size_t length = lengths[i] - MAC_SIZE;
        courier_mac(key, datagrams, length, mac);
        for (size_t j = 0; j < MAC_SIZE; j++) differing |= mac[j] ^ datagrams[length + j];
        genuine[i] = !differing;
    }
}

/* ---- Inbox: what has arrived at a robot's sockets ---- */

enum { MOST_SOCKETS = 2, MOST_ERRORS = 16, ECHO = -1 };

static const int64_t SECOND = 1000000000;
static const int64_t SPIN = 100000;   /* ns that a wait may look for a datagram without sleeping */
static const int64_t YIELDED = 5000;  /* ns: a yield that took longer gave the core to somebody who needs it */
static const int64_t NAP = 20000;     /* ns for each datagram that is missing */
static const unsigned long SLACK = 1000; /* ns by which the kernel may end a sleep later than asked; by itself 50000 */
static const double LONGEST = 1e6;    /* s that can be waited */
static const int32_t MOST_RESTING = 64;

typedef struct { /* what courier.py reads, field by field */
    int32_t errors, error[MOST_ERRORS]; /* of receiving; courier.py empties it */
    int32_t length[MOST_AT_ONCE];       /* of what is in each slot, or ECHO */
    int64_t spins, failed;              /* times that it began to spin, and that nothing came of it */
} Shown;

typedef struct {
    int32_t length; /* ECHO: it has come back, or there was none */
    uint8_t data[LARGEST];
} Sent;

typedef struct {
    Shown shown;
    uint8_t *slots;                           /* MOST_AT_ONCE of LARGEST bytes */
    int32_t used, arrived;                    /* slots; those of them that are no echoes */
    int32_t sockets;
    struct pollfd socket[MOST_SOCKETS];
    int32_t resting, penalty;                 /* waits that will not spin yet; those after the last failure */
    uint32_t next;                            /* in `sent` */
    Sent sent[MOST_ECHOES];                   /* to the group, which gives it back to us too */
    struct iovec place[MOST_AT_ONCE];
    struct mmsghdr message[MOST_AT_ONCE];     /* of each slot, made once: few are touched at a time */
} Inbox;

static int64_t now(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_sec * SECOND + t.tv_nsec;
}

static int64_t nanoseconds(double seconds) {
    return seconds > 0 ? (int64_t)((seconds < LONGEST ? seconds : LONGEST) * 1e9) : 0; /* not a number: 0, too */
}

static int64_t least(int64_t a, int64_t b) { return a < b ? a : b; }

size_t courier_inbox_size(void) { return sizeof(Inbox); }
size_t courier_shown_size(void) { return sizeof(Shown); }

/* `slots` must live as long as the inbox. Of this thread, sleeps become exact. */
void courier_open(Inbox *inbox, uint8_t *slots, const int32_t *sockets, int32_t count) {
    memset(inbox, 0, sizeof *inbox);
    inbox->slots = slots;
    inbox->sockets = count;
    for (int i = 0; i < count; i++) inbox->socket[i] = (struct pollfd){.fd = sockets[i], .events = POLLIN};
    for (int i = 0; i < MOST_ECHOES; i++) inbox->sent[i].length = ECHO;
    for (int i = 0; i < MOST_AT_ONCE; i++) {
        inbox->place[i] = (struct iovec){.iov_base = slots + (size_t)i * LARGEST, .iov_len = LARGEST};
        inbox->message[i].msg_hdr.msg_iov = &inbox->place[i];
        inbox->message[i].msg_hdr.msg_iovlen = 1;
    }
    prctl(PR_SET_TIMERSLACK, SLACK, 0, 0, 0);
}

/* From now on its sockets are not looked at: their numbers may become another's. */
void courier_close(Inbox *inbox) { inbox->sockets = inbox->used = inbox->arrived = 0; }

/* This goes to the group. One that is too long for it comes back cut, and so unlike what was sent. */
void courier_sent(Inbox *inbox, const uint8_t *datagram, int32_t length) {
    Sent *sent = &inbox->sent[inbox->next++ % MOST_ECHOES];
    sent->length = length;
    memcpy(sent->data, datagram, (size_t)(length < LARGEST ? length : LARGEST));
}

/* Whether it is one of those that were sent; each comes back once. Ends of datagrams, where the MAC is, are hardly
   ever alike. */
static int is_echo(Inbox *inbox, const uint8_t *datagram, int32_t length) {
    int32_t tail = length < MAC_SIZE ? length : MAC_SIZE, rest = length - tail;
    for (int i = 0; i < MOST_ECHOES; i++) {
        Sent *sent = &inbox->sent[i];
        if (sent->length == length && !memcmp(sent->data + rest, datagram + rest, (size_t)tail) &&
            !memcmp(sent->data, datagram, (size_t)rest)) {
            sent->length = ECHO;
            return 1;
        }
    }
    return 0;
}

/* Up to IN_TURN datagrams from one socket; whether there may be more. */
static int take(Inbox *inbox, int number) {
    int room = (int)least(IN_TURN, MOST_AT_ONCE - inbox->used);
    if (!room || inbox->shown.errors == MOST_ERRORS) return 0;
    int count = recvmmsg(inbox->socket[number].fd, inbox->message + inbox->used, (unsigned)room, MSG_DONTWAIT, NULL);
    if (count < 0) {
        if (errno == EAGAIN || errno == EWOULDBLOCK || errno == EINTR) return 0;
        inbox->shown.error[inbox->shown.errors++] = errno; /* an earlier send's, nothing about what waits */
        return 1;
    }
    for (int i = 0; i < count; i++, inbox->used++) {
        int32_t length = (int32_t)inbox->message[inbox->used].msg_len;
        int echo = is_echo(inbox, inbox->slots + (size_t)inbox->used * LARGEST, length);
        inbox->shown.length[inbox->used] = echo ? ECHO : length;
        inbox->arrived += !echo;
    }
    return count == room;
}

/* What waits at the sockets, by turns, as far as there is room. */
static void drain(Inbox *inbox) {
    int more = (1 << inbox->sockets) - 1; /* a bit for each socket that may have more */
    while (more)
        for (int i = 0; i < inbox->sockets; i++)
            if (more >> i & 1 && !take(inbox, i)) more &= ~(1 << i);
}

static int some(const Inbox *inbox) {
    return inbox->arrived || inbox->shown.errors || inbox->used == MOST_AT_ONCE;
}

/* Sleep, at most so long; where `wakes`, until something is at a socket. Whether something is, or may be; -1: a signal
   came, which Python must see. */
static int rest(Inbox *inbox, int64_t duration, int wakes) {
    if (duration < 0) duration = 0;
    struct timespec t = {.tv_sec = (time_t)(duration / SECOND), .tv_nsec = (long)(duration % SECOND)};
    int ready = ppoll(inbox->socket, wakes ? (nfds_t)inbox->sockets : 0, &t, NULL);
    if (ready < 0) return errno == EINTR ? -1 : 0;
    return ready || !wakes;
}

/* Look for a datagram without sleeping, for to wake a core takes longer than most wait. Whether one came. Each time
   that none does, twice as many further waits do not try; and who yields and does not get the core back at once lets
   it go: so it costs little where it is of no use. */
static int spin(Inbox *inbox, int64_t until) {
    if (inbox->resting > 0) {
        inbox->resting--;
        return 0;
    }
    inbox->shown.spins++;
    int64_t at = now(), yielded = 0;
    for (until = least(until, at + SPIN); at < until && yielded <= YIELDED; yielded = now() - at, at += yielded) {
        drain(inbox);
        if (some(inbox)) {
            inbox->penalty = 0;
            return 1;
        }
        at = now();
        sched_yield();
    }
    inbox->shown.failed++;
    inbox->penalty = inbox->penalty ? (int32_t)least(2 * inbox->penalty, MOST_RESTING) : 1;
    inbox->resting = inbox->penalty;
    return 0;
}

/* Let what is expected come, without waking for each datagram. -1: a signal came. */
static int gather(Inbox *inbox, int32_t expected, int64_t until) {
    int64_t missing, left;
    for (drain(inbox); (missing = expected - inbox->arrived) > 0 && inbox->used < MOST_AT_ONCE; drain(inbox)) {
        if ((left = until - now()) <= 0) break;
        if (rest(inbox, missing > 1 ? least(NAP * missing, left) : left, missing == 1) < 0) return -1;
    }
    return 0;
}

/* See Transport.wait; both times in seconds. `keep`: what the last call left was not taken, and counts. Ends early when
   a signal comes. Returns how many slots are used, from the first on. */
int32_t courier_wait(Inbox *inbox, double seconds, int32_t expected, double gathering, int32_t keep) {
    int64_t begin = now(), end = begin + nanoseconds(seconds);
    if (!keep) inbox->used = inbox->arrived = 0;
    if (expected > 1 && gathering > 0) {
        if (gather(inbox, expected, least(end, begin + nanoseconds(gathering))) < 0) return inbox->used;
    } else if (keep) {
        drain(inbox);
    } else {
        spin(inbox, end);
    }
    for (; !some(inbox); drain(inbox))
        if (rest(inbox, end - now(), 1) <= 0) break;
    return inbox->used;
}

/* Take what waits, without waiting. Returns how many slots are used, from the first on. */
int32_t courier_receive(Inbox *inbox) {
    inbox->used = inbox->arrived = 0;
    drain(inbox);
    return inbox->used;
}
