/* Mean grey of every frame of a bay of the ring: cc ring.c -o ring && ./ring FILE BAY */

#include <fcntl.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

struct header {
    char magic[8];
    uint32_t layout_version, header_bytes;
    uint64_t file_bytes, generation;
    uint32_t owner_pid, state;
    uint64_t owner_start_ticks;
    uint32_t bays, cameras, slots_per_camera, page_bytes;
    uint64_t slot_bytes, camera_table, bay_table, slot_table, first_slot;
};
struct camera { uint32_t width, height, pixel_format, bytes_per_pixel; };
struct bay { uint64_t generation, reserved; };
struct slot { uint64_t generation; uint32_t state, row; uint64_t frame_id, reserved; };

int main(int argc, char **argv)
{
    if (argc != 3) { fprintf(stderr, "usage: %s FILE BAY\n", argv[0]); return 2; }
    int fd = open(argv[1], O_RDONLY);
    struct stat info;
    if (fd < 0 || fstat(fd, &info) < 0) { perror(argv[1]); return 1; }
    const uint8_t *base = mmap(NULL, info.st_size, PROT_READ, MAP_SHARED, fd, 0);
    if (base == MAP_FAILED) { perror("mmap"); return 1; }
    const struct header *h = (const void *)base;
    if (memcmp(h->magic, "VAOIRING", 8) || h->layout_version != 1 || h->state != 1) return 1;
    const struct camera *cameras = (const void *)(base + h->camera_table);
    const struct bay *bays = (const void *)(base + h->bay_table);
    const struct slot *slots = (const void *)(base + h->slot_table);
    uint64_t bay = strtoull(argv[2], NULL, 10);
    if (bay >= h->bays) return 2;

    uint64_t before = __atomic_load_n(&bays[bay].generation, __ATOMIC_ACQUIRE);
    uint64_t per_bay = (uint64_t)h->cameras * h->slots_per_camera;
    for (uint64_t s = bay * per_bay; s < (bay + 1) * per_bay; s++) {
        if (slots[s].state == 0) continue;
        uint32_t c = (s / h->slots_per_camera) % h->cameras;
        const uint8_t *pixels = base + h->first_slot + s * h->slot_bytes;
        uint64_t count = (uint64_t)cameras[c].width * cameras[c].height, sum = 0;
        for (uint64_t i = 0; i < count; i++)
            sum += cameras[c].bytes_per_pixel == 1 ? pixels[i] : ((const uint16_t *)pixels)[i];
        printf("camera %u row %u %s %.3f\n", c, slots[s].row, slots[s].state == 1 ? "ok" : "incomplete",
               (double)sum / count);
    }
    __atomic_thread_fence(__ATOMIC_ACQUIRE);
    uint64_t after = __atomic_load_n(&bays[bay].generation, __ATOMIC_RELAXED);
    if (before != after) { fprintf(stderr, "the bay went to another board meanwhile\n"); return 3; }
    return 0;
}
