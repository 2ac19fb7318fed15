/* MessagePack as gate.c reads and writes it: whole numbers, and all else as it lies there. Allocates nothing. C99. */

#include <stddef.h>
#include <stdint.h>
#include <string.h>

static const int64_t TOP = (int64_t)1 << 53; /* the largest number in a datagram */

typedef struct {
    const uint8_t *at;
    size_t bytes;
} Text;

typedef struct {
    const uint8_t *at, *end;
} Reader;

/* Reading: each returns whether it was there, and moves on. */

static uint64_t big(const uint8_t *at, int bytes) {
    uint64_t value = 0;
    for (int i = 0; i < bytes; i++) value = value << 8 | at[i];
    return value;
}

static int byte(Reader *reader, uint8_t wanted) { return reader->at < reader->end && *reader->at++ == wanted; }

/* A whole number from -TOP to TOP. */
static int whole(Reader *reader, int64_t *value) {
    if (reader->at >= reader->end) return 0;
    uint8_t kind = *reader->at++;
    if (kind < 0x80 || kind >= 0xe0) {
        *value = (int8_t)kind;
        return 1;
    }
    if (kind < 0xcc || kind > 0xd3) return 0;
    int bytes = 1 << (kind - 0xcc) % 4;
    if (reader->end - reader->at < bytes) return 0;
    uint64_t read = big(reader->at, bytes);
    reader->at += bytes;
    int negative = kind >= 0xd0 && read >> (8 * bytes - 1);
    if (negative && bytes < 8) read |= ~(uint64_t)0 << 8 * bytes;
    if ((negative ? ~read + 1 : read) > (uint64_t)TOP) return 0;
    *value = negative ? -(int64_t)(~read + 1) : (int64_t)read;
    return 1;
}

static int natural(Reader *reader, int64_t *value) { return whole(reader, value) && *value >= 0; }

/* Anything: its parts are counted instead of called for, so no nesting is too deep. */
static int skip(Reader *reader) {
    static const uint8_t LENGTH[32] = {/* 0xc0 */ 0, 0, 0, 0, 1, 2, 4, 1, 2, 4, 4, 8, 1, 2, 4, 8,
                                       /* 0xd0 */ 1, 2, 4, 8, 1, 1, 1, 1, 1, 1, 2, 4, 2, 4, 2, 4};
    uint64_t parts = 1;
    for (; parts; parts--) {
        if (parts > (uint64_t)(reader->end - reader->at)) return 0; /* each has a byte at least */
        uint8_t kind = *reader->at++;
        uint64_t bytes = 0;
        if (kind < 0x80 || kind >= 0xe0) continue;
        if (kind < 0xa0) {
            parts += (uint64_t)(kind & 15) << (kind < 0x90);
            continue;
        }
        if (kind < 0xc0) {
            bytes = kind & 31;
        } else {
            int head = LENGTH[kind - 0xc0];
            if (kind == 0xc1 || reader->end - reader->at < head) return 0;
            bytes = big(reader->at, head);
            reader->at += head;
            if (kind >= 0xdc) { /* arrays and maps */
                parts += bytes << (kind >= 0xde);
                continue;
            }
            if (kind >= 0xc7 && kind <= 0xc9) bytes++;             /* extensions: their type, too */
            else if (kind >= 0xd4 && kind <= 0xd8) bytes = (uint64_t)1 << (kind - 0xd4);
            else if (!(kind >= 0xc4 && kind <= 0xc6) && kind < 0xd9) bytes = 0; /* numbers, nil, bools */
        }
        if (bytes > (uint64_t)(reader->end - reader->at)) return 0;
        reader->at += bytes;
    }
    return 1;
}

/* Writing: each returns the place behind what it has written, for which there must be room. */

static uint8_t *put(uint8_t *at, int64_t value) {
    *at++ = 0xd3;
    for (int i = 56; i >= 0; i -= 8) *at++ = (uint8_t)(value >> i);
    return at;
}

/* The shortest encoding, as msgspec's. */
static uint8_t *shortest(uint8_t *at, int64_t value) {
    int kind = 0; /* of 1, 2, 4 or 8 bytes */
    if (value >= -32 && value < 128) {
        *at++ = (uint8_t)value;
        return at;
    }
    if (value < 0) while (kind < 3 && value < -((int64_t)1 << ((8 << kind) - 1))) kind++;
    else while (kind < 3 && value >> (8 << kind)) kind++;
    *at++ = (uint8_t)((value < 0 ? 0xd0 : 0xcc) + kind);
    for (int i = (8 << kind) - 8; i >= 0; i -= 8) *at++ = (uint8_t)(value >> i);
    return at;
}

static uint8_t *copy(uint8_t *at, const Text *text) {
    memcpy(at, text->at, text->bytes);
    return at + text->bytes;
}
