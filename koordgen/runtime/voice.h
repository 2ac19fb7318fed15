/* The own words' way out. How they begin in this mission is known beforehand, and what speech.py has to say in one of them
   comes as MessagePack: they are put together, with the own closing as it lies in the ledger; gate.c adds the MAC.
   Allocates nothing. The compiler is told by gate.py: LIMIT, MAC_SIZE. C99. */

#include <stdint.h>
#include <string.h>

enum { MOST_BEGIN = 64, SAID_FIELDS = 10 };

typedef int32_t Send(void *inbox, int32_t place, const uint8_t *datagram, int32_t length); /* courier_send */

typedef struct {
    Send *send;                /* or NULL */
    void *inbox;               /* what it is called with */
    double offset;             /* of fleet time, as a word said it last; not a number: it was not known */
    int32_t bytes;             /* of `begin`; 0: no word is said here */
    uint8_t begin[MOST_BEGIN]; /* how they begin, up to their sequence number */
    uint8_t said[LIMIT];       /* the last one, sealed */
} Voice;

/* The payload of a word with one closing, or none (NULL); `fields`: the array of what is said between how all begin and
   the closings. How long it is; 0: longer than a datagram can be, or nothing is said here. */
static int32_t compose(Voice *voice, const uint8_t *fields, int32_t bytes, const Text *closing) {
    if (!voice->bytes || bytes < 1 || fields[0] != 0x90 + SAID_FIELDS) return 0;
    const Text begin = {voice->begin, (size_t)voice->bytes}, rest = {fields + 1, (size_t)bytes - 1};
    const size_t length = begin.bytes + rest.bytes + 1 + (closing ? closing->bytes : 0);
    if (length > LIMIT - MAC_SIZE) return 0;
    uint8_t *at = copy(copy(voice->said, &begin), &rest);
    *at++ = closing ? 0x91 : 0x90;
    if (closing) copy(at, closing);
    return (int32_t)length;
}
