/* The binary of the inner slave, for the platform of this one. */
#if defined _WIN32
#include <windows.h>
#define SYSTEM "windows"
#define SUFFIX ".dll"
#define OLD_SYSTEM "win64"
#elif defined __APPLE__
#include <dlfcn.h>
#define SYSTEM "darwin"
#define SUFFIX ".dylib"
#define OLD_SYSTEM "darwin64"
#else
#include <dlfcn.h>
#define SYSTEM "linux"
#define SUFFIX ".so"
#define OLD_SYSTEM "linux64"
#endif
#if defined __aarch64__ || defined _M_ARM64
#define MACHINE "aarch64"
#else
#define MACHINE "x86_64"
#endif

/* Load the binary from the folder of the inner FMU, in which those of the platform stand under either of two names. */
static int open_library(slave *s, const char *folder, const char *name)
{
    static const char *const platforms[] = {OLD_SYSTEM, MACHINE "-" SYSTEM};
    char path[4096], message[5120];
    for (int i = 0; i < 2 && !s->library; i++) {
        snprintf(path, sizeof path, "%s/binaries/%s/%s" SUFFIX, folder, platforms[i], name);
        FILE *const there = fopen(path, "rb");
        if (!there) {
            continue;
        }
        fclose(there);
#if defined _WIN32
        s->library = (void *)LoadLibraryExA(path, NULL, LOAD_WITH_ALTERED_SEARCH_PATH);
        const char *fault = "LoadLibrary fails";
#else
        s->library = dlopen(path, RTLD_NOW | RTLD_LOCAL);
        const char *fault = s->library ? "" : dlerror();
#endif
        if (!s->library) {
            snprintf(message, sizeof message, "the simulator inside cannot be loaded: %s", fault);
            return refuse(s, message);
        }
    }
    if (!s->library) {
        snprintf(message, sizeof message, "the simulator inside has no binary for " MACHINE "-" SYSTEM " in %s", folder);
        return refuse(s, message);
    }
    return OK;
}

/* Find a function of the inner slave; its address goes to where target points. */
static int find(const slave *s, const char *name, void *target)
{
#if defined _WIN32
    FARPROC symbol = GetProcAddress((HMODULE)s->library, name);
#else
    void *const symbol = dlsym(s->library, name);
#endif
    char message[256];
    if (!symbol) {
        snprintf(message, sizeof message, "the simulator inside lacks the function %s", name);
        return refuse(s, message), 0;
    }
    memcpy(target, &symbol, sizeof symbol);
    return 1;
}

static void close_library(slave *s)
{
    if (s->library) {
#if defined _WIN32
        FreeLibrary((HMODULE)s->library);
#else
        dlclose(s->library);
#endif
    }
    s->library = NULL;
}
