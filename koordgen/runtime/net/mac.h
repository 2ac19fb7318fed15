/* MACs of payloads, as seal.py makes them: BLAKE2s, keyed, for one purpose; those of several datagrams side by side. The
   compiler is told by gate.py: LIMIT, MAC_SIZE. Wants blake2s.h before it. Allocates nothing. C99. */

#include <stdint.h>
#include <string.h>

enum { PURPOSE = 8 };

typedef struct { /* the hash before the first byte of a datagram, with the key already in it */
    uint32_t hash[8], bytes;
} Keyed;

/* `key` has 0 to 32 bytes. */
static void prepare(Keyed *keyed, const uint8_t *key, uint32_t key_bytes, const uint8_t purpose[PURPOSE]) {
    uint8_t block[BLOCK] = {0};
    memcpy(keyed->hash, START, sizeof START);
    keyed->hash[0] ^= 0x01010000u ^ key_bytes << 8 ^ MAC_SIZE;
    keyed->hash[6] ^= little(purpose);
    keyed->hash[7] ^= little(purpose + 4);
    keyed->bytes = key_bytes ? BLOCK : 0;
    if (!key_bytes) return;
    memcpy(block, key, key_bytes);
    compress(keyed->hash, block, BLOCK, 0);
}

/* The MAC of a payload, which has a byte at least. */
static void make_mac(const Keyed *keyed, const uint8_t *at, int32_t rest, uint8_t mac[MAC_SIZE]) {
    uint32_t hash[8], count = keyed->bytes;
    memcpy(hash, keyed->hash, sizeof hash);
    for (; rest > BLOCK; rest -= BLOCK, at += BLOCK) compress(hash, at, count += BLOCK, 0);
    uint8_t block[BLOCK] = {0};
    memcpy(block, at, (size_t)rest);
    compress(hash, block, count + (uint32_t)rest, 1);
    for (int i = 0; i < MAC_SIZE; i++) mac[i] = (uint8_t)(hash[i / 4] >> i % 4 * 8);
}

/* Whether the MAC at its end is right; something must be before it. */
static int is_genuine(const Keyed *keyed, const uint8_t *datagram, int32_t length) {
    const int32_t payload = length - MAC_SIZE;
    if (payload <= 0) return 0;
    uint8_t mac[MAC_SIZE], wrong = 0; /* looked at as a whole: how long it takes tells nothing */
    make_mac(keyed, datagram, payload, mac);
    for (int i = 0; i < MAC_SIZE; i++) wrong |= (uint8_t)(mac[i] ^ datagram[payload + i]);
    return !wrong;
}

/* A lane's next block, of a payload of which `rest` bytes are left; less than nothing: zeros. */
static void load(Lanes m[16], int lane, const uint8_t *at, int32_t rest) {
    uint8_t block[BLOCK] = {0};
    if (rest < BLOCK) at = memcpy(block, at, rest > 0 ? (size_t)rest : 0);
    for (int i = 0; i < 16; i++) m[i][lane] = little(at + 4 * i);
}

/* The same of up to LANES datagrams, `stride` bytes apart: a bit for each. What is longer than LIMIT, of which less is
   there, is not looked at. */
static unsigned are_genuine(const Keyed *keyed, const uint8_t *datagrams, int32_t stride, const int32_t *lengths, int count) {
    if (count == 1) return lengths[0] <= LIMIT && is_genuine(keyed, datagrams, lengths[0]);
    Lanes hash[8], m[16] = {{0}}, taken = {0}, last = {0};
    unsigned genuine = 0;
    int32_t longest = 0, payload[LANES] = {0};
    for (int i = 0; i < 8; i++) hash[i] = (Lanes){0} + keyed->hash[i];
    for (int lane = 0; lane < count; lane++) {
        payload[lane] = lengths[lane] <= LIMIT ? lengths[lane] - MAC_SIZE : 0;
        if (payload[lane] > longest) longest = payload[lane];
    }
    for (int32_t done = 0; done < longest; done += BLOCK) {
        for (int lane = 0; lane < LANES; lane++) {
            const int32_t rest = payload[lane] - done;
            load(m, lane, datagrams + (lane < count ? lane * (ptrdiff_t)stride + (rest > 0 ? done : 0) : 0), rest);
            taken[lane] = keyed->bytes + (uint32_t)(done + (rest < BLOCK ? rest : BLOCK));
            last[lane] = rest > 0 && rest <= BLOCK ? ~(uint32_t)0 : 0;
        }
        compress_all(hash, m, taken, last);
        for (int lane = 0; lane < count; lane++) {
            if (!last[lane]) continue;
            const uint8_t *mac = datagrams + lane * (ptrdiff_t)stride + payload[lane];
            uint32_t wrong = 0; /* as above */
            for (int i = 0; i < MAC_SIZE / 4; i++) wrong |= hash[i][lane] ^ little(mac + 4 * i);
            genuine |= (unsigned)!wrong << lane;
        }
    }
    return genuine;
}
