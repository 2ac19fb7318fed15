/* BLAKE2s, RFC 7693: the compression that the MACs of mac.h are made of. Allocates nothing. C99, and vectors
   as GCC and Clang have them. */

#include <stdint.h>

enum { BLOCK = 64, LANES = 4 };

typedef uint32_t Lanes __attribute__((vector_size(4 * LANES)));

static const uint32_t START[8] = {0x6a09e667, 0xbb67ae85, 0x3c6ef372, 0xa54ff53a,
                                  0x510e527f, 0x9b05688c, 0x1f83d9ab, 0x5be0cd19};
static const uint8_t SIGMA[10][16] = {
    {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15}, {14, 10, 4, 8, 9, 15, 13, 6, 1, 12, 0, 2, 11, 7, 5, 3},
    {11, 8, 12, 0, 5, 2, 15, 13, 10, 14, 3, 6, 7, 1, 9, 4}, {7, 9, 3, 1, 13, 12, 11, 14, 2, 6, 5, 10, 4, 0, 15, 8},
    {9, 0, 5, 7, 2, 4, 10, 15, 14, 1, 11, 12, 6, 8, 3, 13}, {2, 12, 6, 10, 0, 11, 8, 3, 4, 13, 7, 5, 15, 14, 1, 9},
    {12, 5, 1, 15, 14, 13, 4, 10, 0, 7, 6, 3, 9, 2, 8, 11}, {13, 11, 7, 14, 12, 1, 3, 9, 5, 0, 15, 4, 8, 6, 2, 10},
    {6, 15, 14, 9, 11, 3, 0, 8, 12, 2, 13, 7, 1, 4, 10, 5}, {10, 2, 8, 4, 7, 6, 1, 5, 15, 11, 9, 14, 3, 12, 13, 0}};

static uint32_t little(const uint8_t *at) {
    return (uint32_t)at[0] | (uint32_t)at[1] << 8 | (uint32_t)at[2] << 16 | (uint32_t)at[3] << 24;
}

/* Both of words, and of the words of LANES hashes side by side. */
#define TURNED(word, bits) ((word) >> (bits) | (word) << (32 - (bits)))
#define MIX(v, a, b, c, d, x, y)                                    \
    v[a] += v[b] + (x), v[d] = TURNED(v[d] ^ v[a], 16), v[c] += v[d]; \
    v[b] = TURNED(v[b] ^ v[c], 12), v[a] += v[b] + (y);             \
    v[d] = TURNED(v[d] ^ v[a], 8), v[c] += v[d], v[b] = TURNED(v[b] ^ v[c], 7)
#define ROUND(v, m, s)                                                                         \
    MIX(v, 0, 4, 8, 12, m[s[0]], m[s[1]]), MIX(v, 1, 5, 9, 13, m[s[2]], m[s[3]]);                \
    MIX(v, 2, 6, 10, 14, m[s[4]], m[s[5]]), MIX(v, 3, 7, 11, 15, m[s[6]], m[s[7]]);              \
    MIX(v, 0, 5, 10, 15, m[s[8]], m[s[9]]), MIX(v, 1, 6, 11, 12, m[s[10]], m[s[11]]);            \
    MIX(v, 2, 7, 8, 13, m[s[12]], m[s[13]]), MIX(v, 3, 4, 9, 14, m[s[14]], m[s[15]])
#if defined __clang__
#define UNROLLED
#else
#define UNROLLED _Pragma("GCC unroll 10") /* a third faster: which words of the block are taken is known then */
#endif

/* One block into the hash; `count` bytes were taken with it, fewer than 2^32 in all. */
static void compress(uint32_t hash[8], const uint8_t block[BLOCK], uint32_t count, int last) {
    uint32_t m[16], v[16];
    for (int i = 0; i < 16; i++) m[i] = little(block + 4 * i);
    for (int i = 0; i < 8; i++) v[i] = hash[i], v[i + 8] = START[i];
    v[12] ^= count;
    if (last) v[14] = ~v[14];
    UNROLLED
    for (int i = 0; i < 10; i++) {
        ROUND(v, m, SIGMA[i]);
    }
    for (int i = 0; i < 8; i++) hash[i] ^= v[i] ^ v[i + 8];
}

/* The same of a block for each of several hashes, in a third of the time of one after the other. `last` is all ones where
   it is. */
static void compress_all(Lanes hash[8], const Lanes m[16], Lanes count, Lanes last) {
    Lanes v[16];
    for (int i = 0; i < 8; i++) v[i] = hash[i], v[i + 8] = (Lanes){0} + START[i];
    v[12] ^= count;
    v[14] ^= last;
    UNROLLED
    for (int i = 0; i < 10; i++) {
        ROUND(v, m, SIGMA[i]);
    }
    for (int i = 0; i < 8; i++) hash[i] ^= v[i] ^ v[i + 8];
}
