/* The own words' way out. How they begin in this mission is known beforehand, and what speech.py has to say in one of them
   comes as MessagePack: they are put together, with the own closing as it lies in the ledger; gate.c adds the MAC. Where
   there is a clock, words that echo nothing are stamped here. Allocates nothing. The compiler is told by gate.py: LIMIT,
   MAC_SIZE. C99. */

#include <math.h>
#include <stdint.h>
#include <string.h>

enum { MOST_BEGIN = 64, STAMPS = 4, SAID_FIELDS = 10, MOST_STAMPS = 32 };
enum { NOT_POSSIBLE = -1, NOT_STAMPED = -2 }; /* why nothing was sent; errors of the system are positive */

typedef int32_t Send(void *inbox, int32_t place, const uint8_t *datagram, int32_t length); /* courier_send */
typedef double Clock(void); /* the robot's, in seconds */

typedef struct { /* what speech.py reads and writes, field by field */
    double until;     /* by the robot's clock: before, nothing is due to be echoed */
    int64_t sequence; /* of the last word, or any other datagram */
    int64_t fleet;    /* microseconds to be added to our clock for fleet time; */
    int32_t known;    /* whether it is */
} Stamped;

typedef struct {
    Stamped stamped;
    Send *send;                /* or NULL */
    void *inbox;               /* what it is called with */
    Clock *clock;              /* or NULL: only speech.py knows the time */
    int32_t bytes;             /* of `begin`; 0: no word is said here */
    uint8_t begin[MOST_BEGIN]; /* how they begin, up to their sequence number */
    uint8_t said[LIMIT];       /* the last one, sealed */
} Voice;

/* As speech.microseconds. */
static int64_t microseconds(double seconds) { return seconds > 0 ? (int64_t)nearbyint(seconds * 1e6) : 0; }

/* The stamps of the next word (MOST_STAMPS); how long they are; 0: only speech.py can make them. */
static size_t stamp(const Voice *voice, uint8_t *stamps) {
    const Stamped *stamped = &voice->stamped;
    const double now = voice->clock ? voice->clock() : 0;
    if (!voice->clock || !(now < stamped->until)) return 0;
    uint8_t *at = shortest(shortest(stamps, stamped->sequence + 1), microseconds(now));
    if (stamped->known) at = shortest(at, stamped->fleet);
    else *at++ = 0xc0;
    *at++ = 0x90;
    return (size_t)(at - stamps);
}

/* The payload of a word with one closing, or none (NULL); `fields`: the array of what is said between how all begin and
   the closings, or, if there are `stamps`, behind these. How long it is; 0: longer than a datagram can be, or nothing is
   said here. */
static int32_t compose(Voice *voice, const Text *stamps, const uint8_t *fields, int32_t bytes, const Text *closing) {
    const int parts = SAID_FIELDS - (stamps->bytes ? STAMPS : 0);
    if (!voice->bytes || bytes < 1 || fields[0] != 0x90 + parts) return 0;
    const Text begin = {voice->begin, (size_t)voice->bytes}, rest = {fields + 1, (size_t)bytes - 1};
    const size_t length = begin.bytes + stamps->bytes + rest.bytes + 1 + (closing ? closing->bytes : 0);
    if (length > LIMIT - MAC_SIZE) return 0;
    uint8_t *at = copy(copy(copy(voice->said, &begin), stamps), &rest);
    *at++ = closing ? 0x91 : 0x90;
    if (closing) copy(at, closing);
    return (int32_t)length;
}
