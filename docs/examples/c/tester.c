/* Fetch the first image of a component as raw pixels: cc tester.c -o tester -lcurl && ./tester RUN U1 */

#include <curl/curl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

struct pixels { unsigned char *data; size_t size; };

static size_t keep(char *part, size_t one, size_t count, void *user)
{
    struct pixels *p = user;
    unsigned char *grown = realloc(p->data, p->size + one * count);
    if (grown == NULL) return 0;
    memcpy(grown + p->size, part, one * count);
    p->data = grown;
    p->size += one * count;
    return one * count;
}

static long number(CURL *curl, const char *name)
{
    struct curl_header *header;
    return curl_easy_header(curl, name, 0, CURLH_HEADER, -1, &header) == CURLHE_OK ? atol(header->value) : 0;
}

int main(int argc, char **argv)
{
    if (argc != 3) return 2;
    const char *station = getenv("VAOI_STATION");
    char url[1000];
    snprintf(url, sizeof url, "%s/api/v1/runs/%s/components/%s/images/0?format=raw",
             station != NULL ? station : "http://127.0.0.1:8350", argv[1], argv[2]);

    curl_global_init(CURL_GLOBAL_DEFAULT);
    CURL *curl = curl_easy_init();
    struct pixels p = {NULL, 0};
    long status = 0;
    curl_easy_setopt(curl, CURLOPT_URL, url);
    curl_easy_setopt(curl, CURLOPT_WRITEFUNCTION, keep);
    curl_easy_setopt(curl, CURLOPT_WRITEDATA, &p);
    curl_easy_setopt(curl, CURLOPT_TIMEOUT, 60L);
    const char *key = getenv("VAOI_KEY"); /* needed from other machines than the station's */
    if (key != NULL && *key != '\0') {
        curl_easy_setopt(curl, CURLOPT_HTTPAUTH, CURLAUTH_BEARER);
        curl_easy_setopt(curl, CURLOPT_XOAUTH2_BEARER, key);
    }
    CURLcode result = curl_easy_perform(curl);
    curl_easy_getinfo(curl, CURLINFO_RESPONSE_CODE, &status);
    if (result != CURLE_OK || status != 200) {
        fprintf(stderr, "%s: %ld %.*s\n", curl_easy_strerror(result), status, (int)p.size, p.data ? (char *)p.data : "");
        return 1;
    }
    long width = number(curl, "X-Image-Width"), height = number(curl, "X-Image-Height");
    printf("%ld x %ld, %ld bytes per line, %zu bytes\n", width, height, number(curl, "X-Image-Stride"), p.size);
    free(p.data);
    curl_easy_cleanup(curl);
    return 0;
}
